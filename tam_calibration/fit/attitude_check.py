"""Whether recorded attitude agrees with the readings, and how large its errors are.

Most attitudes of robots come from an AHRS that takes its heading from the very magnetometer that is calibrated. Such a
heading repeats the errors of that sensor, and the fit finds them too small, with small standard errors. Attitude is
therefore used only where these tests pass:

- What it tells agrees with what all else tells (Hausman 1978).
- Its heading error contains neither the errors of a sensor's raw readings nor their low-pass, as a filter with a
  gyroscope leaves them: both are columns in addition to the errors of the sensors (a score test).
- Where the recording tells too little for that, the raw readings of no sensor stand still in the heading as well as the
  calibrated field does: good sensors would, so the sizes of the errors by which the sensors differ are the measure.

Roll and pitch come from gravity. Where only the heading fails they are kept, if they agree with all else.
"""

from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.noise import complete_noise
from tam_calibration.fit.agreement import SEEN, TOO_FAR, MotionFit
from tam_calibration.fit.attitude_convention import misread_attitude
from tam_calibration.fit.attitude_likelihood import AttitudeLikelihood, WorldView
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.problem import Known, Problem
from tam_calibration.fit.raw_headings import RawHeadings
from tam_calibration.fit.recorded_attitude import strayed
from tam_calibration.fit.slow_residuals import variance_factors
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.units import FloatArray, to_degrees

_REMEDY = "record an attitude of gyroscope and accelerometer only, without the magnetometer"

_MOST_ROUNDS, _LARGEST_FALL, _SETTLED = 12, 10.0, 0.05
"""To find the noise of attitude from above, by how much it falls in one at most, and the part by which it may change in
the last of them."""

_LOOK = "look at its stamps and frames, at whether the field is uniform, and that no magnetometer is in it"
_NO_FIT = f"the recorded attitude and the readings make no calibration together: {_LOOK}"

_NOISES = (ATTITUDE_NOISE.most, 0.05, 0.005, 5e-4)
"""Noise of attitude to begin with, radians: the first with which a recording that tells little alone is calibrated."""


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
        for noise in _NOISES[:-1]:
            with suppress(InputError, Refused):
                calibration = maximum_a_posteriori(recording, replace(array, attitude_noise=noise), known)
                require_accurate(calibration, recording)
                break
        else:
            noise = _NOISES[-1]
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
            own_white = whitening(left[both, both], SEEN)
            along = own_white.T @ own.score[size:][both]
            chi_square, limit = float(along @ along), SIGNIFICANT / len(raw.names)
            if probability_of(chi_square, len(along)) < limit and (own_white @ along).max() > 0:
                chi_square /= with_headings.lasting(alone[:, both])
                if probability_of(chi_square, len(along)) < limit:
                    followed[-chi_square] = f"follows the errors of {name}, {raw.size_deg(index):.2g}°"
            if raw.is_raw(index, self.noise):
                size_deg = raw.variation_deg(index)
                is_raw[size_deg] = f"is that of the raw readings of {name}, to {size_deg:.2g}°"
        found = followed or is_raw
        return f"the heading of the recorded attitude {found[min(found)]}: {_REMEDY}" if found else ""
