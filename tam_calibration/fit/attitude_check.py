"""Whether recorded attitude may be believed beside the readings, and how large its errors are.

Most attitudes of robots come from an AHRS that takes its heading from the very magnetometer that is calibrated. Such a
heading repeats the errors of that sensor, and the fit finds them too small, with small standard errors. Attitude is
therefore used only where four tests pass:

- What it tells agrees with what all else tells (Hausman 1978).
- Its heading error contains neither the errors of a sensor's raw readings nor their low-pass, as a filter with a
  gyroscope leaves them: both are columns beside the errors of the sensors (a score test).
- Where the recording tells too little for that, the raw readings of no sensor stand still in the heading as well as the
  calibrated field does: good sensors would, so the sizes of the errors by which the sensors differ are the measure.

Roll and pitch come from gravity. Where only the heading fails they are kept, if they agree with all else.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.slow_cosines import BLOCKS
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.posterior import Known, Place, Problem
from tam_calibration.fit.recorded_attitude import likely_turn
from tam_calibration.fit.slow_residuals import slow_factor, variance_factors
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import PARAMETER_NAMES, SensorErrors
from tam_calibration.model.tolerances import Tolerances
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees, to_nanotesla

REMEDY = "record an attitude of gyroscope and accelerometer only, without the magnetometer"

_MOST_ROUNDS, _LARGEST_FALL, _SETTLED = 12, 10.0, 0.05
"""To find the noise of attitude from above, by how much it falls in one at most, and the part by which it may change in
the last of them."""

_NOISES = (ATTITUDE_NOISE.most, 0.05, 0.005, 5e-4)
"""Noise of attitude to begin with, radians: the first with which a recording that tells little alone is calibrated."""

_TOO_FAR = 2.0
"""Stated noise over that of the residuals, or the reverse, from which the stated one is not used: a factor of two in
standard errors. Both counted are the size of the errors and how long they last."""

_LARGEST_SCATTER = from_degrees(10.0)
"""Of the field in the world of the attitude, radians; more is another convention, or another attitude."""

_LEAST_TOLD = 1e-3
"""Part of the information on a direction that both sides have at least where they can contradict."""

_SEEN = 1e-12
"""Part of the largest eigenvalue of a scaled information below which a direction is open."""

_MOST_SAMPLES = 5000
"""Whose headings are compared: more would not change the judgement."""

_DIMENSIONS, _CONVINCING, _LARGEST_RATIO = 2.0, float(np.log(1000.0)), 1e4
"""Least number of errors of a compass (a hard iron's), logarithm of the evidence from which its heading is believed to
be that of raw readings, and the largest ratio of what sensors' errors make of a heading to its noise that is counted."""


_WORTHLESS = 0.95
"""Ratio of standard errors with attitude to those without, above which it is not worth its risk."""

_UNITS = (("", 1.0), ("°", to_degrees(1.0)), (" nT", to_nanotesla(1.0)), ("°", to_degrees(1.0)))
"""Of scale factor, non-orthogonality, bias and misalignment in a sentence, and of one SI unit in it."""

_USUAL, _DRAWS = Tolerances(0.01, from_degrees(0.5), 300e-9, from_degrees(0.5)), 9
"""Errors of a chip, by which a single sensor's heading is judged, and how many are drawn."""


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
        What is known beside the recording.

    Raises
    ------
    InputError, Refused
        As of ``posterior_of``.
    """
    assert array.attitude_noise is not None
    reasons: list[str] = []
    for uses_heading in (True, False):
        fit = _Fit.settled_from_above(recording, array, replace(known, uses_heading=uses_heading, main_field_T=None))
        used, doubt = fit.noise, ""
        if np.isfinite(array.attitude_noise):
            if 1 / _TOO_FAR < array.attitude_noise / fit.noise < _TOO_FAR:
                used = max(array.attitude_noise, fit.noise)
            else:
                doubt = _doubt(array.attitude_noise, fit)
        fit = fit.with_noise(used)
        reason = fit.strayed() or (fit.followed(recording) if uses_heading else "") or fit.contradiction()
        if not reason:
            place = "" if known.main_field_T is None else fit.contradiction_of_place(known.main_field_T)
            return Judgement(used, uses_heading, reasons[0] if reasons else "", doubt, place)
        reasons.append(reason)
    return Judgement(None, False, reasons[0])


def worth_of(recording: SampleSource, calibration: Calibration) -> str:
    """Return what recorded attitude would add to a calibration that was made without it; nothing where there is none.

    The information of its directions, with the scatter that they have about the corrected field, is added to that of
    the calibration: no fit is needed.

    Parameters
    ----------
    recording : SampleSource
        Raw readings that the calibration was made from.
    calibration : Calibration
        With a covariance.
    """
    some = recording.thinned(_MOST_SAMPLES)
    if some.attitude is None or not np.isfinite(some.attitude).all(axis=1).any() or calibration.covariance is None:
        return ""
    array = replace(calibration.array, attitude_noise=ATTITUDE_NOISE.most)
    problem = Problem.of(some, array, Known(start=calibration))
    fit = _Fit(problem, problem.start, ATTITUDE_NOISE.most, 1.0)
    noise = fit.scatter()
    if strayed := replace(fit, noise=noise).strayed():
        return f"recorded attitude is not used: {strayed}"
    assert problem.attitude is not None
    beside = replace(problem, attitude=replace(problem.attitude, attitude_noise=noise))
    information = beside.attitude_at(fit.place).information * recording.sample_count / some.sample_count
    size = len(calibration.covariance)
    cross, view = information[:size, -5:], information[-5:, -5:] + np.eye(5)
    information = information[:size, :size] - cross @ np.linalg.solve(view, cross.T)
    root = calibration.covariance @ whitening(calibration.covariance, _SEEN)
    after = root @ np.linalg.solve(np.eye(root.shape[1]) + root.T @ information @ root, root.T)
    before = calibration.standard_errors
    errors = np.sqrt(np.diag(after)).reshape(before.shape)
    ratio = np.divide(errors, before, out=np.ones_like(before), where=before > 0)
    sensor, parameter = np.unravel_index(int(np.argmin(ratio)), ratio.shape)
    words = f"recorded attitude, which scatters by {to_degrees(noise):.2g}°, is not used: "
    if ratio[sensor, parameter] > _WORTHLESS:
        return f"{words}it would reduce no standard error by more than {1 - _WORTHLESS:.0%}"
    unit, factor = _UNITS[parameter // 3]
    one, other = (factor * float(each[sensor, parameter]) for each in (before, errors))
    return (
        f"{words}it would reduce the standard error of {PARAMETER_NAMES[parameter]} of sensor {sensor + 1} from "
        f"{one:.2g} to {other:.2g}{unit}; if it comes from gyroscope and accelerometer only, set attitude_noise_deg: "
        "estimate in the array file"
    )


def _doubt(stated: float, fit: "_Fit") -> str:
    size = "small" if stated < fit.noise else "large"
    lasting = f", lasting for {fit.lasting:.2g} samples," if fit.lasting > 1 else ""
    return (
        f"attitude_noise_deg, stated as {to_degrees(stated):.3g}, is too {size}: the attitude scatters by "
        f"{to_degrees(fit.noise / np.sqrt(fit.lasting)):.3g}°{lasting} which was used; state "
        f"{to_degrees(fit.noise):.3g}, or estimate"
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fit beside attitude: the noise that its residuals show, radians, and for how many samples they last."""

    problem: Problem
    place: Place
    noise: float
    lasting: float

    @classmethod
    def settled_from_above(cls, recording: SampleSource, array: Array, known: Known) -> "_Fit":
        """Return the fit whose noise is that of the residuals, from attitudes that hardly weigh to what they are worth.

        The readings are weighed by what they leave before attitude can pull them.
        """
        for noise in _NOISES[:-1]:
            with suppress(InputError, Refused):
                calibration = maximum_a_posteriori(recording, replace(array, attitude_noise=noise), known)
                require_accurate(calibration)
                break
        else:
            noise = _NOISES[-1]
            calibration = maximum_a_posteriori(recording, replace(array, attitude_noise=noise), known)
        factors = known.variance_factors.at_least(variance_factors(calibration, recording))
        problem = Problem.of(recording, calibration.array, replace(known, variance_factors=factors))
        fit = cls(problem, problem.start, noise, 1.0).with_noise(noise)
        for _ in range(_MOST_ROUNDS):
            noise = max(fit.scatter(), fit.noise / _LARGEST_FALL)
            if abs(noise - fit.noise) <= _SETTLED * fit.noise:
                break
            try:
                fit = fit.with_noise(noise)
            except Refused:
                # At rest, an attitude that is all but exact leaves its mounting open and the steps small.
                break
        lasting = fit.measure_lasting()
        return replace(fit, noise=float(min(np.sqrt(lasting) * fit.noise, ATTITUDE_NOISE.most)), lasting=lasting)

    def with_noise(self, noise: float) -> "_Fit":
        """Return the fit of attitudes of another noise."""
        assert self.problem.attitude is not None
        problem = replace(self.problem, attitude=replace(self.problem.attitude, attitude_noise=noise))
        place, _ = problem.most_probable()
        return replace(self, problem=problem, place=place, noise=noise)

    def scatter(self) -> float:
        """Return the standard deviation of attitude that the residuals show, radians."""
        own = self.problem.attitude_at(self.place)
        taken = float(np.sum(self._shares(own.information, own.gradient)[0]))
        variance = (self.noise**2 + own.field_variance) * own.energy / max(own.channels - taken, 1.0)
        # A scatter that is less than that of the field's direction is not told from none.
        variance = max(variance - own.field_variance, own.field_variance)
        return float(np.clip(np.sqrt(variance), ATTITUDE_NOISE.least, ATTITUDE_NOISE.most))

    def measure_lasting(self) -> float:
        """Return by how much what attitude tells varies more than by white noise."""
        assert self.problem.attitude is not None
        count = len(self.problem.attitude.to_world)
        if count < BLOCKS:
            return 1.0
        edges = np.linspace(0, count, BLOCKS + 1).astype(int)
        parts = [self.problem.attitude_at(self.place, slice(*span)) for span in zip(edges[:-1], edges[1:], strict=True)]
        basis = self.problem.basis_at(self.place)
        information = np.array([basis.T @ part.information @ basis for part in parts])
        white = whitening(information.sum(axis=0), _SEEN)
        score = np.array([white.T @ basis.T @ part.gradient for part in parts])
        return slow_factor(white.T @ information @ white, score)

    def _white(self) -> FloatArray:
        """Return directions of the free unknowns on which the information of all is one."""
        information, gradient = self.problem.data_at(self.place)
        self.problem.add_known(self.place, information, gradient)
        basis = self.problem.basis_at(self.place)
        return np.asarray(basis @ whitening(basis.T @ information @ basis, _SEEN))

    def _shares(self, information: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the part that some information is of all on each direction, and its gradient along them."""
        white = self._white()
        shares, directions = np.linalg.eigh(white.T @ information @ white)
        return np.clip(shares, 0, 1), directions.T @ white.T @ gradient

    def strayed(self) -> str:
        """Return by how much the field turns in the world of the attitude, where that is no noise, or nothing."""
        if self.noise / np.sqrt(self.lasting) < _LARGEST_SCATTER:
            return ""
        degrees = to_degrees(self.noise / np.sqrt(self.lasting))
        return (
            f"the field of the readings does not stand still in the world of the recorded attitude but turns by "
            f"{degrees:.0f}°, which must be the turn from the array to the world, x y z w, at the time of the sample"
        )

    def contradiction(self) -> str:
        """Return how attitude contradicts all else, or nothing."""
        own = self.problem.attitude_at(self.place)
        sizes = self._difference(own.information, own.gradient)
        what = "heading" if self.problem.known.uses_heading else "roll and pitch"
        noise = f"with {to_degrees(self.noise):.2g}° of noise"
        return f"the {what} of the recorded attitude contradicts the readings, {sizes} {noise}" if sizes else ""

    def contradiction_of_place(self, main_field_T: FloatArray) -> str:
        """Return how the main field of a model contradicts readings and attitude, or nothing."""
        known = replace(self.problem.known, main_field_T=main_field_T)
        beside = replace(self, problem=replace(self.problem, known=known)).with_noise(self.noise)
        size = len(beside.problem.basis_at(beside.place))
        added = []
        for problem in (beside.problem, self.problem):
            own = np.zeros((size, size)), np.zeros(size)
            problem.add_known(beside.place, *own)
            added.append(own)
        (information, gradient), (less, downhill) = added
        sizes = beside._difference(information - less, gradient - downhill)
        return f"the field of the place contradicts readings and attitude, {sizes}" if sizes else ""

    def _difference(self, information: FloatArray, gradient: FloatArray) -> str:
        """Return χ² of the difference that some information makes to the estimate, where chance hardly makes as much.

        At the best errors its score is what the others' balances, and has the variance of the parallel sum of both
        informations (Hausman 1978): no fit without it is needed.
        """
        shares, score = self._shares(information, gradient)
        told = (shares > _LEAST_TOLD) & (1 - shares > _LEAST_TOLD)
        chi_square, freedom = float(np.sum(score[told] ** 2 / (shares * (1 - shares))[told])), int(told.sum())
        if probability_of(chi_square, freedom) >= SIGNIFICANT:
            return ""
        return f"χ² {chi_square:.3g} of {freedom} errors"

    def followed(self, recording: SampleSource) -> str:
        """Return which readings the heading follows, or nothing."""
        headings = _Headings.of(self, recording)
        white = self._white()
        for name, columns, raw in headings.candidates():
            own = self.problem.attitude_at(self.place, headings=columns)
            size = len(white)
            coupled = white.T @ own.information[:size, size:]
            scale = np.sqrt(np.diag(own.information)[size:])
            left = own.information[size:, size:] - coupled.T @ coupled
            inverse = np.linalg.pinv(left / np.outer(scale, scale), rcond=1e-6, hermitian=True)
            score = own.gradient[size:] / scale
            sizes = inverse @ score
            chance = probability_of(float(score @ sizes), len(sizes))
            if chance < SIGNIFICANT / len(headings.raw) and sizes.max() > 0:
                return f"the heading of the recorded attitude follows the errors of {name}, {headings.size(raw):.2g}°"
            if headings.is_raw(raw, self.noise):
                return (
                    f"the heading of the recorded attitude is that of the raw readings of {name}, to "
                    f"{to_degrees(float(np.sqrt(np.mean(raw**2)))):.2g}°"
                )
        return ""


@dataclass(frozen=True, eq=False)
class _Headings:
    """Headings of the calibrated field and of raw readings in the world of the attitude, about their means, radians.

    Parameters
    ----------
    calibrated : (N,) array
        Of the field that the sensors agree on.
    raw : dict of str to (N,) array
        Of the readings of each sensor and of their mean, each in its best mounting.
    level : float
        Mean cosine of the dip: an angle of heading turns the field by as much less.
    usual : float
        Sum of squares of what the usual errors of a sensor make of a heading.
    """

    calibrated: FloatArray
    raw: dict[str, FloatArray]
    level: float
    usual: float

    @classmethod
    def of(cls, fit: _Fit, recording: SampleSource) -> "_Headings":
        attitude = fit.problem.attitude
        assert attitude is not None
        samples = recording.whole()
        assert samples.attitude is not None
        readings = samples.readings_T[np.isfinite(samples.attitude).all(axis=1)]
        fields = {f"sensor {sensor + 1}": readings[:, sensor] for sensor in range(readings.shape[1])}
        if readings.shape[1] > 1:
            fields["all sensors"] = readings.mean(axis=1)
        field = attitude.field(*fit.problem.rows_at(fit.place))
        calibrated, level = _heading(field, attitude.to_world)
        raw = {name: _heading(each, attitude.to_world)[0] for name, each in fields.items()}
        errors = np.random.default_rng(0).normal(size=(_DRAWS, 12)) * np.sqrt(_USUAL.variances())
        errors[:, 6:9] /= fit.place.intensity_T
        wrong = SensorErrors.from_vector(errors + np.repeat([1.0, 0.0], [3, 9])).distort(field)
        usual = [np.sum((_heading(each, attitude.to_world)[0] - calibrated) ** 2) for each in wrong.swapaxes(0, 1)]
        return cls(calibrated, raw, level, float(np.median(usual)))

    def candidates(self) -> Iterator[tuple[str, FloatArray, FloatArray]]:
        """Yield each name, the errors of heading that an AHRS of it makes, without and with a filter, and its heading."""
        time = np.linspace(-1, 1, len(self.calibrated))
        for name, raw in sorted(self.raw.items(), key=lambda item: float(np.sum(item[1] ** 2))):
            filtered = raw / 2 - np.cumsum(raw)
            filtered -= np.polyval(np.polyfit(time, filtered, 1), time)
            yield name, np.array([self.calibrated - raw, filtered]), raw

    def size(self, raw: FloatArray) -> float:
        """Return the root mean square of what the errors of readings make of a heading, degrees."""
        return to_degrees(float(np.std(self.calibrated - raw)))

    def is_raw(self, raw: FloatArray, noise: float) -> bool:
        """Return whether it is more probable that the heading is that of raw readings than that these have few errors.

        Their errors are as large as those by which sensors differ, and of a single sensor large.
        """
        precision = (self.level / noise) ** 2
        others = [each for each in self.raw.values() if each is not raw]
        size = np.median([np.sum((each - raw) ** 2) for each in others]) / 2 if others else self.usual
        ratio = min(precision * float(size), _LARGEST_RATIO)
        likelihood = precision * float(np.sum(self.calibrated**2) - np.sum(raw**2)) / 2
        return bool(likelihood + _DIMENSIONS / 2 * np.log1p(ratio / _DIMENSIONS) > _CONVINCING)


def _heading(field: FloatArray, to_world: FloatArray) -> tuple[FloatArray, float]:
    """Return how headings (N,) of fields (N, 3) differ from their mean in the best mounting, and the cosine of the dip."""
    unit = field / norm(field, axis=1, keepdims=True)
    turned = to_world @ likely_turn(unit, to_world)
    world = np.einsum("nij,nj->ni", turned, unit)
    level = norm(world[:, :2], axis=1)
    mean = world[:, :2].mean(axis=0)
    angle = np.arctan2(mean[0] * world[:, 1] - mean[1] * world[:, 0], world[:, :2] @ mean)
    by_mount = np.einsum("nij,njk->nik", turned, np.cross(np.eye(3)[None], unit[:, None]).swapaxes(1, 2))
    slope = (world[:, 0, None] * by_mount[:, 1] - world[:, 1, None] * by_mount[:, 0]) / level[:, None] ** 2
    columns = np.column_stack([slope, np.ones(len(angle))])
    return angle - columns @ np.linalg.lstsq(columns, angle, rcond=1e-3)[0], float(level.mean())
