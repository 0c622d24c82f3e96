"""Whether recorded attitude agrees with the readings, how large its errors are, and what it would add.

Most attitudes of robots come from an AHRS that takes its heading from the very magnetometer that is calibrated. Such a
heading repeats the errors of that sensor, and the fit finds them too small, with small standard errors. Attitude is
therefore used only where these tests pass:

- What it tells agrees with what all else tells (Hausman 1978).
- Its heading error contains neither the errors of a sensor's raw readings nor their low-pass, as a filter with a
  gyroscope leaves them: both are columns in addition to the errors of the sensors (a score test).
- Where the recording tells too little for that, the raw readings of no sensor are as constant in the heading as the
  calibrated field does: good sensors would, so the sizes of the errors by which the sensors differ are the measure.

Roll and pitch come from gravity. Where only the heading fails they are kept, if they agree with all else.

What a compass of uncorrected readings would make of the heading, and whether a recorded heading is one.

An AHRS levels the readings of a magnetometer by gravity and turns until they point north. Its heading is off by what
the errors of the sensor make of the direction of the field; with a gyroscope and a filter, by the low-pass of that.

What recorded attitude would add to a calibration that was made without it.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm, pinv

from tam_calibration.core.field_alignment import turns_between
from tam_calibration.core.least_squares import ROUNDING, whitening
from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.contradiction import SIGNIFICANT, TOO_FAR, MotionFit, probability_of
from tam_calibration.fit.estimate import variance_factors
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.fit.recorded_attitude import (
    AttitudeLikelihood,
    WorldView,
    misread_attitude,
    strayed,
)
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.mounting import rotation_matrix
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.model.units import FloatArray, for_people, from_degrees, to_degrees

_REMEDY = "record an attitude of gyroscope and accelerometer only, without the magnetometer"

_MOST_ROUNDS, _LARGEST_FALL, _SETTLED = 12, 10.0, 0.05
"""To find the noise of attitude from above, by how much it falls in one at most, and the part by which it may change in
the last of them."""

_LOOK = "look at its stamps and frames, at whether the field is uniform, and that no magnetometer is in it"
_NO_FIT = f"the recorded attitude and the readings make no calibration together: {_LOOK}"


@dataclass(frozen=True, eq=False)
class Judgement:
    """What attitude may be used for.

    Parameters
    ----------
    attitude_noise : float, optional
        To fit with, radians; None where attitude is left out.
    uses_heading : bool
        Whether the heading counts too.
    reason : str
        Why something is left out, by name and size; empty where nothing is.
    doubt : str
        What is wrong with the stated noise; empty where it is right, or none is stated.
    place : str
        Why the main field of a model is left out; empty where it agrees, or is not given.
    """

    attitude_noise: float | None
    uses_heading: bool = True
    reason: str = ""
    doubt: str = ""
    place: str = ""


def judge_attitude(recording: SampleSource, array: Array, known: Known) -> Judgement:
    """Return what the recorded attitude may be used for.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field, with attitude.
    array : Array
        Its noise of attitude is infinite where it is to be estimated.
    known : Known
        What else is known.

    Returns
    -------
    Judgement
        Of an attitude that makes no fit with the readings nothing is used.
    """
    assert array.attitude_noise is not None
    reasons: list[str] = []
    for uses_heading in (True, False):
        without_place = replace(known, uses_heading=uses_heading, main_field_T=None)
        try:
            fit = _Fit.settled_from_above(recording, array, without_place)
            used, doubt = _used_noise(array.attitude_noise, fit)
            fit = fit.with_noise(used)
        except (InputError, Refused):
            stray = strayed(_scatter_at_start(recording, array, without_place)) or _NO_FIT
            reasons.append(misread_attitude(recording) or stray)
            continue
        stray = strayed(fit.left)
        reason = (
            (stray and misread_attitude(recording))
            or stray
            or (fit.followed(recording) if uses_heading else "")
            or fit.contradiction()
        )
        if not reason:
            place = "" if known.main_field_T is None else fit.contradiction_of_place(known.main_field_T)
            return Judgement(used, uses_heading, reasons[0] if reasons else "", doubt, place)
        reasons.append(reason)
    return Judgement(None, False, reasons[0])


def _scatter_at_start(recording: SampleSource, array: Array, known: Known) -> float:
    noisy, _ = complete_noise(replace(array, attitude_noise=ATTITUDE_NOISE.most), recording)
    problem = Problem.of(recording, noisy, known)
    assert problem.motion is not None and problem.start.motion is not None
    return problem.motion.scatter(*problem.rows_at(problem.start), problem.start.motion)


def _used_noise(stated: float, fit: "_Fit") -> tuple[float, str]:
    """Return the noise to fit with, radians, and what is wrong with the stated one; infinite where it is estimated."""
    if np.isinf(stated):
        return fit.noise, ""
    if 1 / TOO_FAR < stated / fit.noise < TOO_FAR:
        return max(stated, fit.noise), ""
    size = "small" if stated < fit.noise else "large"
    lasting = (fit.noise / fit.left) ** 2
    words = f" for {lasting:.2g} samples at a time" if lasting > 1 else ""
    return fit.noise, (
        f"the stated attitude_noise_deg, {to_degrees(stated):.3g}, is too {size}: the attitude is off by "
        f"{to_degrees(fit.left):.3g}°{words}, and counts as that; state {to_degrees(fit.noise):.3g}, or estimate"
    )


@dataclass(frozen=True, eq=False)
class _Fit(MotionFit):
    """A fit with attitude as data: its noise, and the scatter of the residuals, smaller where they last; radians."""

    noise: float
    left: float

    @classmethod
    def settled_from_above(cls, recording: SampleSource, array: Array, known: Known) -> "_Fit":
        """Return the fit with the noise of its residuals, from attitudes that hardly weigh to what they are worth.

        The readings are weighed by what they leave before attitude can pull them.
        """
        # A recording that tells little alone is calibrated with attitudes that weigh more.
        noises = (ATTITUDE_NOISE.most / _LARGEST_FALL ** np.arange(4)).tolist()
        for noise in noises[:-1]:
            with suppress(InputError, Refused):
                calibration = maximum_a_posteriori(recording, replace(array, attitude_noise=noise), known)
                require_accurate(calibration, recording)
                break
        else:
            noise = noises[-1]
            calibration = maximum_a_posteriori(recording, replace(array, attitude_noise=noise), known)
        factors = known.variance_factors.at_least(variance_factors(calibration, recording))
        problem = Problem.of(recording, calibration.array, replace(known, variance_factors=factors))
        fit = cls(problem, problem.start, noise, noise).with_noise(noise)
        for _ in range(_MOST_ROUNDS):
            noise = max(fit.scatter, fit.noise / _LARGEST_FALL)
            if abs(noise - fit.noise) <= _SETTLED * fit.noise:
                break
            fit = fit.with_noise(noise)
        noise = min(float(np.sqrt(fit.lasting())) * fit.noise, ATTITUDE_NOISE.most)
        return replace(fit, noise=noise, left=fit.noise)

    def with_noise(self, noise: float) -> "_Fit":
        """Return the fit of attitudes of another noise."""
        problem = replace(self.problem, motion=replace(self.attitude, attitude_noise=noise))
        place, _ = problem.most_probable()
        return replace(self, problem=problem, place=place, noise=noise)

    @property
    def attitude(self) -> AttitudeLikelihood:
        """The samples with attitude."""
        assert isinstance(self.problem.motion, AttitudeLikelihood)
        return self.problem.motion

    def contradiction(self) -> str:
        """Return how attitude contradicts all else, or nothing."""
        sizes = self.difference(self.own)
        what = "heading" if self.problem.known.uses_heading else "roll and pitch"
        noise = f"with {to_degrees(self.noise):.2g}° of noise"
        words = f"the {what} of the recorded attitude contradicts the readings, {sizes} {noise}: {_LOOK}"
        return words if sizes else ""

    def contradiction_of_place(self, main_field_T: FloatArray) -> str:
        """Return how the main field of a model contradicts readings and attitude, or nothing."""
        known = replace(self.problem.known, main_field_T=main_field_T)
        used = replace(self, problem=replace(self.problem, known=known)).with_noise(self.noise)
        more, less = (problem.known_at(used.place) for problem in (used.problem, self.problem))
        sizes = used.difference(more - less)
        return f"the field of the place contradicts readings and attitude, {sizes}" if sizes else ""

    def followed(self, recording: SampleSource) -> str:
        """Return which readings the heading follows, or nothing."""
        samples, attitude, view = recording.whole(), self.attitude, self.place.motion
        assert isinstance(view, WorldView) and samples.attitude is not None
        readings_T = samples.readings_T[np.isfinite(samples.attitude).all(axis=1)]
        field = attitude.field(*self.problem.rows_at(self.place))
        turned = attitude.to_world @ view.mount
        raw = RawHeadings.of(readings_T, field, turned, view.direction, self.place.intensity_T)
        white, size = self.white, len(self.basis)
        with_headings = MotionFit(replace(self.problem, motion=replace(attitude, headings=raw.columns)), self.place)
        own = with_headings.own
        # Each error of the heading less what errors of the sensors make that are as probable.
        alone = np.vstack([-white @ white.T @ own.information[:size, size:], np.eye(len(raw.columns))])
        left = own.information[size:] @ alone
        followed, is_raw = {}, {}
        for index, name in enumerate(raw.names):
            both = slice(2 * index, 2 * index + 2)
            own_white = whitening(left[both, both], ROUNDING)
            along = own_white.T @ own.score[size:][both]
            chi_square, limit = float(along @ along), SIGNIFICANT / len(raw.names)
            if probability_of(chi_square, len(along)) < limit and (own_white @ along).max() > 0:
                chi_square /= with_headings.lasting(alone[:, both])
                if probability_of(chi_square, len(along)) < limit:
                    size_deg = to_degrees(float(np.std(raw.errors[index])))
                    followed[-chi_square] = f"follows the errors of {name}, {size_deg:.2g}°"
            if raw.is_raw(index, self.noise):
                size_deg = to_degrees(float(np.std(raw.left[index])))
                is_raw[size_deg] = f"is that of the raw readings of {name}, to {size_deg:.2g}°"
        found = followed or is_raw
        return f"the heading of the recorded attitude {found[min(found)]}: {_REMEDY}" if found else ""


_DIMENSIONS, _CONVINCING, _LARGEST_RATIO = 2.0, float(np.log(1000.0)), 1e4
"""Errors of a compass that a hard iron makes, logarithm of the evidence from which a heading is believed to be raw, and
the largest ratio of what sensors' errors make of a heading to its noise that is counted."""

_USUAL, _DRAWS = Tolerances(0.01, from_degrees(0.5), 300e-9, from_degrees(0.5)), 9
"""Errors of a chip, by which a single sensor's heading is judged, and how many are drawn."""


@dataclass(frozen=True, eq=False)
class RawHeadings:
    """Headings of the corrected field and of M raw readings in the world of the attitude, radians.

    Parameters
    ----------
    names : tuple of str
        Of the raw readings: of each sensor and of all together.
    errors : (M, N) array
        What an AHRS of them is off by: the heading of the corrected field less theirs.
    left : (M, N) array
        How their headings vary in the recorded attitude, but for what another mounting explains.
    corrected : (N,) array
        The same of the corrected field.
    level : float
        Mean cosine of the dip: an angle of heading turns the field by as much less.
    usual : float
        Sum of squares of what the usual errors of a sensor make of the heading.
    """

    names: tuple[str, ...]
    errors: FloatArray
    left: FloatArray
    corrected: FloatArray
    level: float
    usual: float

    @classmethod
    def of(
        cls, readings_T: FloatArray, field: FloatArray, turned: FloatArray, direction: FloatArray, intensity_T: float
    ) -> "RawHeadings":
        """Return the headings of a recording.

        Parameters
        ----------
        readings_T : (N, K, 3) array
            Raw readings, tesla.
        field : (N, 3) array
            Direction of the corrected field in the array frame.
        turned : (N, 3, 3) array
            From the array frame to the world, by the recorded attitude.
        direction : (3,) array
            Of the field in the world.
        intensity_T : float
            Of the field, tesla.
        """
        count = readings_T.shape[1]
        names = tuple(f"sensor {sensor + 1}" for sensor in range(count)) + (("all sensors",) if count > 1 else ())
        raw = np.concatenate([readings_T, readings_T.mean(axis=1, keepdims=True)], axis=1)[:, : len(names)]
        deviates = np.random.default_rng(0).normal(size=(_DRAWS, 12)) * np.sqrt(_USUAL.variances())
        deviates[:, 6:9] /= intensity_T
        usual = SensorErrors.from_vector(deviates + np.repeat([1.0, 0.0], [3, 9])).distort(field)
        world = np.einsum("nij,nj->ni", turned, field)
        # With the field where it belongs, what follows is not correlated with the errors of the attitude.
        agreeing = rotation_matrix(turns_between(world, direction)) @ turned
        errors = -_heading(np.einsum("nij,nkj->kni", agreeing, np.concatenate([raw, usual], axis=1)))
        columns = _by_mounting(field, agreeing, direction)
        headings = np.vstack([_heading(world), _heading(world) - errors[: len(names)], errors[len(names) :]])
        # Part of the largest singular value below which a turn of the mounting does not show in the heading.
        left = headings - headings @ pinv(columns, rcond=1e-3).T @ columns.T
        return cls(
            names,
            errors[: len(names)],
            left[1 : 1 + len(names)],
            left[0],
            float(norm(world[:, :2], axis=1).mean()),
            float(np.median(np.sum(left[1 + len(names) :] ** 2, axis=1))),
        )

    @property
    def columns(self) -> FloatArray:
        """(2 M, N) errors of heading that an AHRS of each of the readings makes: without a filter, and with a slow one.

        The filter's are those whose rate is the variation of the raw heading, but for a trend.
        """
        filtered = self.left / 2 - np.cumsum(self.left, axis=1)
        trend = np.polynomial.polynomial.polyvander(np.linspace(-1, 1, filtered.shape[1]), 1)
        filtered -= filtered @ pinv(trend).T @ trend.T
        return np.stack([self.errors, filtered], axis=1).reshape(-1, filtered.shape[1])

    def is_raw(self, index: int, attitude_noise: float) -> bool:
        """Return whether the recorded heading is that of raw readings, rather than these happen to have few errors.

        The evidence is the ratio of the likelihoods, times Occam's factor for errors that would be as large as those by
        which sensors differ, and of a single sensor as usual.
        """
        precision = (self.level / attitude_noise) ** 2
        energy = np.sum((self.left - self.left[index]) ** 2, axis=1)
        # Of two sensors both differ; of all together the errors are as much smaller as there are sensors.
        shared = 2 if index < len(energy) - 1 else len(energy) - 1
        size = np.median(np.delete(energy, index)) / shared if len(energy) > 1 else self.usual
        ratio = min(precision * float(size), _LARGEST_RATIO)
        likelihood = precision * float(np.sum(self.corrected**2) - np.sum(self.left[index] ** 2)) / 2
        return bool(likelihood + _DIMENSIONS / 2 * np.log1p(ratio / _DIMENSIONS) > _CONVINCING)


def _heading(world: FloatArray) -> FloatArray:
    """Return the angles (..., N) about the vertical of vectors (..., N, 3) against their mean, radians."""
    mean = world[..., :2].mean(axis=-2, keepdims=True)
    across = mean[..., 0] * world[..., 1] - mean[..., 1] * world[..., 0]
    return np.asarray(np.arctan2(across, np.sum(world[..., :2] * mean, axis=-1)))


def _by_mounting(field: FloatArray, turned: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the (N, 4) derivatives of the heading by a turn of the mounting, and by north."""
    moved = np.einsum("nij,njk->nik", turned, np.cross(np.eye(3)[None], field[:, None]).swapaxes(1, 2))
    across = direction[0] * moved[:, 1] - direction[1] * moved[:, 0]
    return np.column_stack([across / np.sum(direction[:2] ** 2), np.ones(len(field))])


USE_IT = (
    "set attitude_noise_deg: estimate in the array file if the recorded attitude comes from gyroscope and "
    "accelerometer only"
)


_UNITS = ("", "rad", "T", "rad")
"""Of scale factor, non-orthogonality, bias and misalignment, SI."""


def worth_of(recording: SampleSource, calibration: Calibration) -> str:
    """Return what recorded attitude would add to a calibration that was made without it; nothing where there is none.

    The information of its directions, with the scatter that they have about the corrected field, is added to that of
    the calibration: no fit is needed.

    Parameters
    ----------
    recording : SampleSource
        Raw readings that the calibration was made from.
    calibration : Calibration
        Of that recording, without attitude.
    """
    # By which the worth of attitude is judged.
    some = recording.thinned(1000)
    if some.attitude is None or not np.isfinite(some.attitude).all(axis=1).any():
        return ""
    array = replace(calibration.array, attitude_noise=ATTITUDE_NOISE.most)
    problem = Problem.of(some, array, Known(start=calibration))
    assert isinstance(problem.motion, AttitudeLikelihood) and isinstance(problem.start.motion, WorldView)
    noise = problem.motion.scatter(*problem.rows_at(problem.start), problem.start.motion)
    if reason := strayed(noise):
        return misread_attitude(some, calibration.errors) or f"recorded attitude is not used: {reason}"
    used = MotionFit(replace(problem, motion=replace(problem.motion, attitude_noise=noise)), problem.start)
    information = used.own.information * recording.sample_count / some.sample_count
    words = f"recorded attitude (noise {to_degrees(noise):.2g}°) is not used: "
    # Ratio of standard errors with attitude to those without, above which it is not worth its risk.
    worthless = 0.95
    if _ratio(calibration, information).min() < worthless:
        information /= used.lasting()
    ratio = _ratio(calibration, information)
    if ratio.min() > worthless:
        return f"{words}it would reduce no standard error by more than {1 - worthless:.0%}"
    sensor, parameter = np.unravel_index(int(np.argmin(ratio)), ratio.shape)
    factor, unit = for_people(_UNITS[parameter // 3])
    before = factor * float(calibration.standard_errors[sensor, parameter])
    return (
        f"{words}it would reduce the standard error of {PARAMETER_NAMES[parameter]} of sensor {sensor + 1} from "
        f"{before:.2g} to {ratio.min() * before:.2g}{' ' * (unit == 'nT')}{unit}; {USE_IT}"
    )


def _ratio(calibration: Calibration, information: FloatArray) -> FloatArray:
    """Return the (K, 12) standard errors with more information over those without; its last unknowns are the view."""
    size, before = len(calibration.covariance), calibration.standard_errors
    cross, view = information[:size, -5:], information[-5:, -5:] + np.eye(5)
    information = information[:size, :size] - cross @ np.linalg.solve(view, cross.T)
    root = calibration.covariance @ whitening(calibration.covariance, ROUNDING)
    after = root @ np.linalg.solve(np.eye(root.shape[1]) + root.T @ information @ root, root.T)
    errors = np.sqrt(np.diag(after)).reshape(before.shape)
    return np.asarray(np.divide(errors, before, out=np.ones_like(before), where=before > 0))
