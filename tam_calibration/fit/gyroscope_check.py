"""Whether a recorded angular velocity agrees with the readings, and how large its errors are.

It is used where the field turns as it says, and where what it tells agrees with what all else tells (Hausman 1978). Its
unit, mounting and delay are found; its bias and how this wanders are unknowns of the fit. Its noise is that of the
residuals over several samples: between neighbours a filter may leave less. Axes that are not at right angles, or of
different scale, are taken for true unless the residuals show them (a score test): where little turns the array about
an axis, an error of scale cannot be separated from errors of the sensors.
"""

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import complete_noise, fast_noise
from tam_calibration.fit.agreement import FAR, TOO_FAR
from tam_calibration.fit.gyroscope_fit import GyroscopeFit
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState, GyroscopeUse
from tam_calibration.fit.gyroscope_start import UNITS, matched
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.gyroscope import Gyroscope
from tam_calibration.model.limits import RATE_NOISE
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray, to_degrees

_FEWEST = 100
"""Intervals whose turn is known: with fewer the noise is uncertain by more than a tenth."""

MOST_SAMPLES = 2_000_000
"""Samples up to which angular velocity is used: all are in memory then."""

MOST_LINKS = 20_000
"""Turns from sample to sample that are judged: of more those over several samples."""

_SURE = 3.0
"""Standard deviations of chance by which residuals may be less than those of the noise that is used."""

_SHAPE = 0.03
"""Standard deviation of the scale and the angles of axes that are not true: data sheets bound them by 1 to 3 %."""

_SATURATED = 4
"""Readings of an axis that are its largest, over those of the next value, from which they are the end of its range."""


@dataclass(frozen=True, eq=False)
class GyroscopeJudgement:
    """What an angular velocity may be used for.

    Parameters
    ----------
    recording : SampleSource
        Its angular velocity in rad/s, without readings at the end of the range.
    use : GyroscopeUse, optional
        How it counts; None where it is left out.
    reason : str
        Why it is left out; empty where it is not.
    notes : tuple of str
        What was found of it.
    doubt : str
        What is wrong with the stated noise; empty where it is right, or none is stated.
    place : Place, optional
        Where the fit with it settled.
    """

    recording: SampleSource
    use: GyroscopeUse | None
    reason: str = ""
    notes: tuple[str, ...] = ()
    doubt: str = ""
    place: Place | None = None


def judge_gyroscope(recording: Recording, array: Array, known: Known, since_s: float = -np.inf) -> GyroscopeJudgement:
    """Return what the angular velocity of a recording may be used for.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors in a uniform field, with angular velocity.
    array : Array
        The noise of its gyroscope is estimated where it is not stated.
    known : Known
        What else is known.
    since_s : float
        Stamp from which on it is known: samples before are not judged.
    """
    assert recording.angular_velocity_rad_s is not None
    cleaned, notes = _within_range(recording.angular_velocity_rad_s)
    recording = replace(recording, angular_velocity_rad_s=cleaned)
    is_judged = recording.time_s >= since_s
    some, rates = recording.take(is_judged), cleaned[is_judged]
    interval_s = float(np.median(np.diff(some.time_s))) if some.sample_count > 1 else 0.0
    path = GyroscopePath(some.time_s, rates, interval_s, some.time_span_s)
    if len(path.links) < _FEWEST:
        return GyroscopeJudgement(recording, None, "the angular velocity spans too few samples without gaps")
    try:
        noisy, _ = complete_noise(array, some)
        field = Problem.of(some, noisy, known).start.errors.restore(some.readings_T).mean(axis=1)
        match = matched(field / norm(field, axis=1, keepdims=True), path)
        if match.reason:
            return GyroscopeJudgement(recording, None, match.reason)
        recording = replace(recording, angular_velocity_rad_s=UNITS[match.unit] * cleaned)
        some = recording.take(is_judged)
        if match.unit != "rad/s":
            notes += (f"the angular velocity is in {match.unit}, and taken as that: state it in rad/s",)
        stated = array.gyroscope or Gyroscope()
        noise = stated.noise_density or _fast_density(UNITS[match.unit] * rates, interval_s)
        start = GyroscopeState.at_rest(match.mount, match.delay_s)
        stride = -(-some.sample_count // MOST_LINKS)
        use = GyroscopeUse(noise, stated.bias, interval_s, start, stated.scale_error, stride=stride)
        fit = GyroscopeFit.settled(some, array, known, use)
        if not use.shape_error and fit.is_bent:
            fit = GyroscopeFit.settled(some, array, known, replace(fit.use, start=fit.state, shape_error=_SHAPE))
            notes += (fit.bent,)
        if (bias := float(norm(fit.state.bias[0]))) > FAR * stated.bias:
            fit = GyroscopeFit.settled(some, array, known, replace(fit.use, start=fit.state, bias_error=bias))
            notes += (_biased(bias, stated.bias),)
        density, doubt = _used_density(array.gyroscope, fit)
        fit = fit.with_density(density).weighed()
    except (InputError, Refused):
        return GyroscopeJudgement(recording, None, "the angular velocity and the readings make no calibration together")
    if reason := fit.contradiction():
        return GyroscopeJudgement(recording, None, reason, notes)
    return GyroscopeJudgement(recording, fit.begun, "", (*notes, *fit.remarks()), doubt, fit.place)


def _within_range(rates: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return angular velocities without those at the end of the range of an axis, and a note of them."""
    known, at_end = np.isfinite(rates).all(axis=1), np.zeros(len(rates), dtype=bool)
    for axis, side in product(range(3), (1.0, -1.0)):
        values, counts = np.unique(side * rates[known, axis], return_counts=True)
        # Of a coarse gyroscope each value is frequent; at the end of its range all that is beyond is one value.
        if counts[-1] >= _SATURATED * max(counts[-2:-1].max(initial=1), 1):
            at_end |= side * rates[:, axis] == values[-1]
    if not at_end.any():
        return rates, ()
    count = int(np.count_nonzero(at_end))
    note = f"{count} of {len(rates)} angular velocities are at the end of the gyroscope's range, and left out"
    return np.where(at_end[:, None], np.nan, rates), (note,)


def _fast_density(rates: FloatArray, interval_s: float) -> float:
    """Return the density of the noise that fast differences of the angular velocity show."""
    noise = float(np.sqrt(np.mean(fast_noise(rates[np.isfinite(rates).all(axis=1)]) ** 2)))
    return float(np.clip(noise * np.sqrt(2 * interval_s), RATE_NOISE.least, RATE_NOISE.most))


def _used_density(gyroscope: Gyroscope | None, fit: GyroscopeFit) -> tuple[float, str]:
    """Return the density to fit with, and what is wrong with the stated one."""
    found, most = fit.measured(), max(fit.measured(_SURE), RATE_NOISE.least)
    stated = None if gyroscope is None else gyroscope.noise_density
    if stated is None:
        return max(found, most), ""
    if stated < TOO_FAR * most and found < TOO_FAR * stated:
        return max(stated, found), ""
    size, used = ("small", found) if stated < found else ("large", most)
    words = (
        f"noise_mdps_per_sqrt_Hz, {_in_mdps(stated):.3g}, is too {size}: its errors are those of {_in_mdps(used):.3g}"
    )
    return used, f"the stated {words}, and count as that"


def _in_mdps(density: float) -> float:
    return 1000 * to_degrees(density)


def _biased(bias: float, stated: float) -> str:
    return (
        f"the gyroscope's bias is {to_degrees(bias):.3g} °/s, beyond the {to_degrees(stated):.3g} °/s of "
        "bias_deg_per_s, and is estimated"
    )
