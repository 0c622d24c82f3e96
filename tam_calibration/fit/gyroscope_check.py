"""Whether a recorded angular velocity agrees with the readings, and how large its errors are.

It is used where the field turns as it says, and where what it tells agrees with what all else tells (Hausman 1978). Its
unit, mounting and delay are found; its bias and how this wanders are unknowns of the fit. Its noise is that of the
residuals over several samples: between neighbours a filter may leave less. Axes that are not at right angles, or of
different scale, are taken for true unless the residuals show them (a score test): where little turns the array about
an axis, an error of scale cannot be separated from errors of the sensors.

A fit with angular velocity as data: its noise by the residuals, and what these show of the gyroscope.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import MOST_STEPS, ROUNDING, whitening
from tam_calibration.core.noise import complete_noise, fast_noise
from tam_calibration.fit.contradiction import FAR, SIGNIFICANT, TOO_FAR, MotionFit, probability_of
from tam_calibration.fit.estimate import variance_factors
from tam_calibration.fit.gyroscope_likelihood import GyroscopeLikelihood
from tam_calibration.fit.gyroscope_path import UNITS, GyroscopePath, GyroscopeState, GyroscopeUse, matched
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import SETTLED, maximum_a_posteriori
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.limits import RATE_NOISE
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.units import FloatArray, from_degrees, rounded, to_degrees, to_nanotesla


@dataclass(frozen=True, eq=False)
class GyroscopeFit(MotionFit):
    """A fit with angular velocity as data."""

    @classmethod
    def settled(cls, recording: Recording, array: Array, known: Known, use: GyroscopeUse) -> "GyroscopeFit":
        """Return the fit with the noise that its residuals show, or the first one where that is more.

        The readings are weighed by what they leave.
        """
        first = maximum_a_posteriori(recording, array, replace(known, gyroscope=use))
        factors = known.variance_factors.at_least(variance_factors(first, recording))
        start = Place(first.errors, first.intensity_T)
        used = replace(known, gyroscope=use, variance_factors=factors, start=start)
        problem = Problem.of(recording, first.array, used)
        fit = cls(problem, problem.most_probable()[0])
        for _ in range(MOST_STEPS):
            density = max(fit.measured(), use.density)
            if abs(density - fit.use.density) <= SETTLED * fit.use.density:
                break
            fit = fit.with_density(density)
        return fit

    @property
    def likelihood(self) -> GyroscopeLikelihood:
        """The angular velocity as data."""
        assert isinstance(self.problem.motion, GyroscopeLikelihood)
        return self.problem.motion

    @property
    def use(self) -> GyroscopeUse:
        """How the angular velocity counts."""
        return self.likelihood.use

    @property
    def state(self) -> GyroscopeState:
        """Of the gyroscope."""
        assert isinstance(self.place.motion, GyroscopeState)
        return self.place.motion

    @property
    def begun(self) -> GyroscopeUse:
        """How the angular velocity counts, its fit begun where this one ends."""
        # 200_000: turns of a fit to all samples: of more those over several samples.
        return replace(self.use, start=self.state, stride=-(-self.likelihood.sample_count // 200_000))

    def _settled_with(self, use: GyroscopeUse) -> "GyroscopeFit":
        problem = replace(self.problem, motion=replace(self.likelihood, use=use))
        return GyroscopeFit(problem, problem.settled(self.place, is_corrected=True)[0])

    def with_density(self, density: float) -> "GyroscopeFit":
        """Return the fit with another noise of the gyroscope."""
        if density == self.use.density:
            return self
        return self._settled_with(replace(self.use, density=density))

    def measured(self, sigmas: float = 0.0) -> float:
        """Return the density of the noise that the residuals show over several samples."""
        path = self.likelihood.path
        # 8 and 50: intervals over which noise is measured, and how many of these there are at least.
        slow = self.likelihood.coarser(max(1, min(-(-8 // path.stride), len(path.links) // 50)))
        return slow.scatter(*self.problem.rows_at(self.place), self.state, self.taken, sigmas)

    def weighed(self) -> "GyroscopeFit":
        """Return the fit with the weight that slow errors of the angular velocity leave it."""
        factor = self.lasting()
        return self if factor == 1 else self._settled_with(replace(self.use, lasting=factor))

    @property
    def is_bent(self) -> bool:
        """Whether the residuals show axes that are not true: the score of their scales and angles."""
        information, gradient = self.everything.information, self.everything.score
        shape = np.arange(len(gradient) - 6, len(gradient))
        across = self.white.T @ information[:, shape]
        white = whitening(information[np.ix_(shape, shape)] - across.T @ across, ROUNDING)
        score = white.T @ gradient[shape]
        return probability_of(float(score @ score), len(score)) < SIGNIFICANT

    def contradiction(self) -> str:
        """Return how angular velocity contradicts all else, or nothing."""
        sizes = self.difference(self.own)
        words = "look at its stamps and axes, and at whether the field is uniform"
        return f"the angular velocity contradicts the readings, {sizes}: {words}" if sizes else ""

    @cached_property
    def covariance(self) -> FloatArray:
        """(Q, Q) covariance of the unknowns."""
        return inverted(self.everything.information, self.basis)

    @property
    def turned(self) -> tuple[str, str]:
        """How the gyroscope is turned against sensor 1: a note, or a doubt where it is far; empty where it is not.

        Left-handed sensors read the reversed field of sensors that are turned by 180°, and a gyroscope does not tell
        which way the field points.
        """
        from scipy.spatial.transform import Rotation

        turn = Rotation.from_matrix(self.state.mount).as_rotvec()
        angle, errors = float(norm(turn)), np.sqrt(np.diag(self.covariance))[-self.state.size :][self.state.turn]
        # from_degrees(2.0): turn from which it is worth a note.
        if angle <= max(FAR * float(norm(errors)), from_degrees(2.0)):
            return "", ""
        turned = f"the gyroscope is turned by {rounded(to_degrees(angle))}° against sensor 1, which is estimated"
        # How far a sensor is mounted askew at most.
        askew = from_degrees(15.0)
        if angle < askew:
            return turned, ""
        axis = int(np.argmax(np.abs(turn)))
        if float(norm(np.abs(turn) - np.pi * np.eye(3)[axis])) < askew:
            turned += f", or axis {'xyz'[axis]} of all sensors is reversed, which are left-handed then"
        return "", f"{turned}: state imu_rotation_deg, or rotations_deg of the sensors, in the array file"

    def remarks(self) -> tuple[str, ...]:
        """Return how the gyroscope is late and turned, and what its scale may do, in a sentence each."""
        information, covariance = self.everything.information, self.covariance
        count, notes = self.state.bias.size, []
        delay_error_s = float(np.sqrt(covariance.diagonal()[-self.state.size :][count]))
        # 0.5: delay in intervals of samples from which it is worth a note.
        if abs(self.state.delay_s) > max(FAR * delay_error_s, 0.5 * self.use.interval_s):
            late = "late" if self.state.delay_s > 0 else "early"
            notes.append(f"the angular velocity is {abs(self.state.delay_s):.3g} s {late}, which is taken off")
        notes += filter(None, self.turned[:1])
        # A scale error of all axes moves the errors of the sensors by so much.
        shift = -covariance @ information[:, -6:-3].sum(axis=1)
        biases = np.arange(12 * self.place.errors.sensor_count).reshape(-1, 12)[:, 6:9].ravel()
        # Scale error of a gyroscope that was calibrated, whose effect is reported.
        typical_scale = 1e-3
        moved_nT = typical_scale * to_nanotesla(float(norm(shift[biases])))
        if not self.use.shape_error and moved_nT > to_nanotesla(
            float(np.sqrt(np.trace(covariance[biases][:, biases])))
        ):
            notes.append(
                f"the gyroscope's scale is taken for true: {100 * typical_scale:g} % of it would move the biases by "
                f"{rounded(moved_nT)} nT; state scale_error_percent"
            )
        return tuple(notes)


MOST_SAMPLES = 2_000_000
"""Samples up to which angular velocity is used: all are in memory then."""


def judge_gyroscope(
    recording: Recording, array: Array, known: Known, since_s: float = -np.inf
) -> tuple[Recording, "SettledGyroscope"]:
    """Return a recording with its angular velocity in rad/s and within its range, and what that may be used for.

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
    cleaned, notes = within_range(recording.angular_velocity_rad_s)
    recording = replace(recording, angular_velocity_rad_s=cleaned)
    settled = settled_gyroscope(recording.take(recording.time_s >= since_s), array, known)
    recording, fit = replace(recording, angular_velocity_rad_s=UNITS[settled.unit] * cleaned), settled.fit
    if fit is None:
        return recording, settled
    if reason := fit.contradiction():
        return recording, SettledGyroscope(None, reason)
    doubt = "; ".join(filter(None, (fit.turned[1], settled.doubt)))
    return recording, settled._replace(notes=(*notes, *settled.notes, *fit.remarks()), doubt=doubt)


class SettledGyroscope(NamedTuple):
    """A fit with angular velocity, or the reason why there is none; its unit, and what was found of it.

    The doubt is what is wrong with the stated noise or mounting; empty where both are right, or none is stated.
    """

    fit: GyroscopeFit | None
    reason: str = ""
    unit: str = "rad/s"
    notes: tuple[str, ...] = ()
    doubt: str = ""


def settled_gyroscope(recording: Recording, array: Array, known: Known) -> SettledGyroscope:
    """Return the fit of a recording with its angular velocity.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors in a uniform field, with angular velocity within its range.
    array : Array
        The noise of its gyroscope is estimated where it is not stated.
    known : Known
        What else is known.
    """
    too_few = SettledGyroscope(None, "the angular velocity spans too few samples without gaps")
    rates = recording.angular_velocity_rad_s
    if rates is None:
        return too_few
    interval_s = float(np.median(np.diff(recording.time_s))) if recording.sample_count > 1 else 0.0
    path = GyroscopePath(recording.time_s, rates, interval_s, recording.time_span_s)
    # Intervals whose turn is known: with fewer the noise is uncertain by more than a tenth.
    if len(path.links) < 100:
        return too_few
    notes: tuple[str, ...] = ()
    try:
        noisy, _ = complete_noise(array, recording)
        field = Problem.of(recording, noisy, known).start.errors.restore(recording.readings_T).mean(axis=1)
        match = matched(field / norm(field, axis=1, keepdims=True), path)
        if match.reason:
            return SettledGyroscope(None, match.reason)
        rates = UNITS[match.unit] * rates
        recording = replace(recording, angular_velocity_rad_s=rates)
        if match.unit != "rad/s":
            notes += (f"the angular velocity is in {match.unit}, and taken as that: state it in rad/s",)
        stated = array.gyroscope or Gyroscope()
        fast = np.sqrt(np.mean(fast_noise(rates[np.isfinite(rates).all(axis=1)]) ** 2))
        limited = np.clip(fast * np.sqrt(2 * interval_s), RATE_NOISE.least, RATE_NOISE.most)
        noise = stated.noise_density or float(limited)
        start = GyroscopeState.at_rest(match.mount, match.delay_s)
        # Of a long recording the turns over several samples are judged, as many as samples of a block.
        stride = -(-recording.sample_count // BLOCK)
        # Second differences of white jitter have six times its variance. Their median size, 0.6745 of the standard
        # deviation, forgives gaps.
        jitter_s = float(np.median(np.abs(np.diff(recording.time_s, 2)))) / 0.6745 / np.sqrt(6)
        use = GyroscopeUse(noise, stated.bias, interval_s, start, stated.scale_error, stride=stride, jitter_s=jitter_s)
        fit = GyroscopeFit.settled(recording, array, known, use)
        if not use.shape_error and fit.is_bent:
            # Standard deviation of the scale and the angles of axes that are not true: data sheets bound them by
            # 1 to 3 %.
            fit = GyroscopeFit.settled(recording, array, known, replace(fit.use, start=fit.state, shape_error=0.03))
            percent = 100 * float(np.abs(fit.state.shape - np.eye(3)).max())
            differ = f"scale and angles of the gyroscope's axes differ by up to {percent:.2g} % from those of the array"
            notes += (f"{differ}, which is estimated",)
        if (bias := float(norm(fit.state.bias[0]))) > FAR * stated.bias:
            fit = GyroscopeFit.settled(recording, array, known, replace(fit.use, start=fit.state, bias_error=bias))
            beyond = f"beyond the {to_degrees(stated.bias):.3g} °/s of bias_deg_per_s"
            notes += (f"the gyroscope's bias is {to_degrees(bias):.3g} °/s, {beyond}, and is estimated",)
        density, doubt = _used_density(array.gyroscope, fit)
        fit = fit.with_density(density).weighed()
    except (InputError, Refused):
        return SettledGyroscope(None, "the angular velocity and the readings make no calibration together")
    return SettledGyroscope(fit, "", match.unit, notes, doubt)


def within_range(rates: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return angular velocities (N, 3) with NaN where an axis is at the end of its range, and a note of that."""
    known, at_end = np.isfinite(rates).all(axis=1), np.zeros(len(rates), dtype=bool)
    for axis, side in product(range(3), (1.0, -1.0)):
        values, counts = np.unique(side * rates[known, axis], return_counts=True)
        # Of a coarse gyroscope each value is frequent; at the end of its range all that is beyond is one value.
        # Readings of an axis that are its largest, over those of the next value, from which they are the end of its
        # range.
        if counts[-1] >= 4 * max(counts[-2:-1].max(initial=1), 1):
            at_end |= side * rates[:, axis] == values[-1]
    if not at_end.any():
        return rates, ()
    count = int(np.count_nonzero(at_end))
    note = f"{count} of {len(rates)} angular velocities are at the end of the gyroscope's range, and left out"
    return np.where(at_end[:, None], np.nan, rates), (note,)


def _used_density(gyroscope: Gyroscope | None, fit: GyroscopeFit) -> tuple[float, str]:
    """Return the density to fit with, and what is wrong with the stated one."""
    # Standard deviations of chance by which residuals may be less than those of the noise that is used.
    found, most = fit.measured(), max(fit.measured(3.0), RATE_NOISE.least)
    stated = None if gyroscope is None else gyroscope.noise_density
    if stated is None:
        return max(found, most), ""
    if stated < TOO_FAR * most and found < TOO_FAR * stated:
        return max(stated, found), ""
    size, used = ("small", found) if stated < found else ("large", most)
    stated_mdps, used_mdps = 1000 * to_degrees(stated), 1000 * to_degrees(used)
    return used, (
        f"the stated noise_mdps_per_sqrt_Hz, {stated_mdps:.3g}, is too {size}: its errors are those of {used_mdps:.3g}"
        ", and count as that"
    )
