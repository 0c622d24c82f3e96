"""Whether a recorded angular velocity may be believed beside the readings, and how large its errors are.

It is used where the field turns as it says, and where what it tells agrees with what all else tells (Hausman 1978). Its
unit, mounting and delay are found; its bias and how this wanders are unknowns of the fit. Its noise is that of the
residuals over several samples: between neighbours a filter may leave less. Axes that are not at right angles, or of
different scale, are taken for true unless the residuals show them (a score test): where little turns the array about
an axis, an error of scale is told from no error of the sensors.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import complete_noise, fast_noise
from tam_calibration.fit.agreement import SEEN, difference, lasting, shares, white_directions
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.gyroscope_likelihood import GyroscopeEquations
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState, GyroscopeUse
from tam_calibration.fit.gyroscope_start import UNITS, matched
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.posterior import Known, Place, Problem
from tam_calibration.fit.slow_residuals import variance_factors
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.gyroscope import Gyroscope
from tam_calibration.model.limits import RATE_NOISE
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees, to_nanotesla

_FEWEST = 100
"""Intervals whose turn is known: of fewer the noise is not told to a tenth."""

MOST_SAMPLES, _MOST_FITTED = 2_000_000, 200_000
"""Samples up to which angular velocity is used, as all are in memory then, and turns of a fit to all of them."""

MOST_LINKS = 20_000
"""Turns from sample to sample that are judged: of more those over several samples."""

_STRIDE, _FEWEST_STRIDES = 8, 50
"""Intervals over which noise is measured, and how many of these there are at least."""

_MOST_ROUNDS, _SETTLED = 6, 0.05
"""To find the noise, and the part by which it may change in the last of them."""

_TOO_FAR = 2.0
"""Noise of the residuals over the stated one, or the reverse, from which the stated one is not used."""

_FAR = 4.0
"""Standard deviations of a normal law beyond which a bias, a delay or a mounting is told: once in 16 000."""

_SURE = 3.0
"""Standard deviations of chance by which residuals may be less than those of the noise that is used."""

_SHAPE = 0.03
"""Standard deviation of the scale and the angles of axes that are not true: data sheets bound them by 1 to 3 %."""

_TYPICAL_SCALE = 1e-3
"""Scale error of a gyroscope that was calibrated, of which the effect is told."""

_LATE, _ASKEW = 0.5, from_degrees(2.0)
"""Delay in intervals of samples, and turn in radians, from which they are worth a note."""

_SATURATED = 3
"""Readings of an axis that are its largest or smallest, from which the gyroscope has reached its range."""


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
        Where the fit beside it settled.
    """

    recording: SampleSource
    use: GyroscopeUse | None
    reason: str = ""
    notes: tuple[str, ...] = ()
    doubt: str = ""
    place: Place | None = None


def judge_gyroscope(recording: Recording, array: Array, known: Known) -> GyroscopeJudgement:
    """Return what the angular velocity of a recording may be used for.

    Parameters
    ----------
    recording : Recording
        Raw readings of K sensors in a uniform field, with angular velocity.
    array : Array
        The noise of its gyroscope is estimated where it is not stated.
    known : Known
        What is known beside the recording.
    """
    assert recording.angular_velocity_rad_s is not None
    rates, notes = _within_range(recording.angular_velocity_rad_s)
    recording = replace(recording, angular_velocity_rad_s=rates)
    interval_s = float(np.median(np.diff(recording.time_s))) if recording.sample_count > 1 else 0.0
    path = GyroscopePath(recording.time_s, rates, interval_s, recording.time_span_s)
    if len(path.links) < _FEWEST:
        return GyroscopeJudgement(recording, None, "the angular velocity spans too few samples without gaps")
    try:
        noisy, _ = complete_noise(array, recording)
        field = Problem.of(recording, noisy, known).start.errors.restore(recording.readings_T).mean(axis=1)
        match = matched(field / norm(field, axis=1, keepdims=True), path)
        if match.reason:
            return GyroscopeJudgement(recording, None, match.reason)
        recording = replace(recording, angular_velocity_rad_s=UNITS[match.unit] * rates)
        if match.unit != "rad/s":
            notes += (f"the angular velocity is in {match.unit}, and taken as that: state it in rad/s",)
        stated = array.gyroscope or Gyroscope()
        noise = stated.noise_density or _fast_density(UNITS[match.unit] * rates, interval_s)
        start = GyroscopeState.at_rest(match.mount, match.delay_s)
        stride = -(-recording.sample_count // MOST_LINKS)
        use = GyroscopeUse(noise, stated.bias, interval_s, start, stated.scale_error, stride=stride)
        fit = _Fit.settled(recording, array, known, use)
        if not use.shape_error and fit.is_bent:
            fit = _Fit.settled(recording, array, known, replace(fit.use, start=fit.state, shape_error=_SHAPE))
            notes += (f"{_bent(fit.state)}, which is estimated",)
        if (bias := float(norm(fit.state.bias[0]))) > _FAR * stated.bias:
            fit = _Fit.settled(recording, array, known, replace(fit.use, start=fit.state, bias_error=bias))
            notes += (_biased(bias, stated.bias),)
    except (InputError, Refused):
        return GyroscopeJudgement(recording, None, "the angular velocity and the readings make no calibration together")
    density, doubt = _used_density(array.gyroscope, fit)
    fit = fit.with_density(density)
    fit = fit.lasting()
    if reason := fit.contradiction():
        return GyroscopeJudgement(recording, None, reason, notes)
    return GyroscopeJudgement(recording, fit.begun, "", (*notes, *fit.remarks()), doubt, fit.place)


def _within_range(rates: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Return angular velocities without those at the end of the range of an axis, and a note of them."""
    known = np.isfinite(rates).all(axis=1)
    ends = np.stack([rates[known].min(axis=0), rates[known].max(axis=0)])
    is_end = (rates[None] == ends[:, None]) & (ends != 0)[:, None]
    is_reached = is_end.sum(axis=1) >= _SATURATED
    at_end = (is_end & is_reached[:, None]).any(axis=(0, 2))
    # A coarse gyroscope that hardly turns reads few values, each often.
    is_coarse = len(np.unique(rates[known], axis=0)) < np.count_nonzero(known) / 2
    if is_coarse or not at_end.any():
        return rates, ()
    count = int(np.count_nonzero(at_end))
    note = f"{count} of {len(rates)} angular velocities are at the end of the gyroscope's range, and left out"
    return np.where(at_end[:, None], np.nan, rates), (note,)


def _fast_density(rates: FloatArray, interval_s: float) -> float:
    """Return the density of the noise that fast differences of the angular velocity show."""
    noise = float(np.sqrt(np.mean(fast_noise(rates[np.isfinite(rates).all(axis=1)]) ** 2)))
    return float(np.clip(noise * np.sqrt(2 * interval_s), RATE_NOISE.least, RATE_NOISE.most))


def _used_density(gyroscope: Gyroscope | None, fit: "_Fit") -> tuple[float, str]:
    """Return the density to fit with, and what is wrong with the stated one."""
    found, most = fit.measured(), max(fit.measured(_SURE), RATE_NOISE.least)
    stated = None if gyroscope is None else gyroscope.noise_density
    if stated is None:
        return max(found, most), ""
    if stated < _TOO_FAR * most and found < _TOO_FAR * stated:
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


def _bent(state: GyroscopeState) -> str:
    size = 100 * float(np.abs(state.shape - np.eye(3)).max())
    return f"scale and angles of the gyroscope's axes differ by up to {size:.2g} % from those of the array"


@dataclass(frozen=True, eq=False)
class _Fit:
    """A fit beside angular velocity."""

    problem: Problem
    place: Place

    @classmethod
    def settled(cls, recording: Recording, array: Array, known: Known, use: GyroscopeUse) -> "_Fit":
        """Return the fit with the noise that its residuals show, or the first one where that is more.

        The readings are weighed by what they leave.
        """
        first = maximum_a_posteriori(recording, array, replace(known, gyroscope=use))
        factors = known.variance_factors.at_least(variance_factors(first, recording))
        start = Place(first.errors, first.intensity_T)
        beside = replace(known, gyroscope=use, variance_factors=factors, start=start)
        problem = Problem.of(recording, first.array, beside)
        fit = cls(problem, problem.most_probable()[0])
        for _ in range(_MOST_ROUNDS):
            density = max(fit.measured(), use.density)
            if abs(density - fit.use.density) <= _SETTLED * fit.use.density:
                break
            fit = fit.with_density(density)
        return fit

    @property
    def use(self) -> GyroscopeUse:
        """How the angular velocity counts."""
        assert self.problem.known.gyroscope is not None
        return self.problem.known.gyroscope

    @property
    def state(self) -> GyroscopeState:
        """Of the gyroscope."""
        assert self.place.gyroscope is not None
        return self.place.gyroscope

    @property
    def begun(self) -> GyroscopeUse:
        """How the angular velocity counts, its fit begun where this one ends."""
        likelihood = self.problem.gyroscope
        assert likelihood is not None
        return replace(self.use, start=self.state, stride=-(-len(likelihood.path.time_s) // _MOST_FITTED))

    def _with(self, use: GyroscopeUse) -> "_Fit":
        likelihood = self.problem.gyroscope
        assert likelihood is not None
        likelihood = replace(likelihood, density=use.density, lasting=use.lasting)
        problem = replace(self.problem, known=replace(self.problem.known, gyroscope=use), gyroscope=likelihood)
        return _Fit(problem, self.place)

    def with_density(self, density: float) -> "_Fit":
        """Return the fit with another noise of the gyroscope."""
        if density == self.use.density:
            return self
        fit = self._with(replace(self.use, density=density))
        return replace(fit, place=fit.problem.settled(fit.place, is_corrected=True)[0])

    @cached_property
    def _own(self) -> GyroscopeEquations:
        """What the angular velocity tells."""
        return self.problem.gyroscope_at(self.place)

    @cached_property
    def _all(self) -> tuple[FloatArray, FloatArray]:
        """Information and gradient of all that is known."""
        information, gradient = self.problem.data_at(self.place)
        self.problem.add_known(self.place, information, gradient)
        return information, gradient

    @cached_property
    def _white(self) -> FloatArray:
        return white_directions(self._all[0], self.problem.basis_at(self.place))

    def measured(self, sigmas: float = 0.0) -> float:
        """Return the density of the noise that the residuals show over several samples."""
        likelihood = self.problem.gyroscope
        assert likelihood is not None
        path = likelihood.path
        slow = likelihood.coarser(max(1, min(-(-_STRIDE // path.stride), len(path.links) // _FEWEST_STRIDES)))
        taken = float(np.sum(shares(self._white, self._own.information, self._own.gradient)[0]))
        return slow.scatter(*self.problem.rows_at(self.place), self.state, taken, sigmas)

    def lasting(self) -> "_Fit":
        """Return the fit with the weight that slow errors of the angular velocity leave it."""
        along = self.problem.basis_at(self.place)
        count = len(self.problem.gyroscope.path.time_s) if self.problem.gyroscope else 0
        factor = lasting(lambda span: self.problem.gyroscope_at(self.place, span), count, along)
        if factor == 1:
            return self
        fit = self._with(replace(self.use, lasting=factor))
        return replace(fit, place=fit.problem.settled(fit.place, is_corrected=True)[0])

    @property
    def is_bent(self) -> bool:
        """Whether the residuals show axes that are not true: the score of their scales and angles."""
        (information, gradient), size = self._all, self.state.size
        shape = np.arange(len(gradient) - 6, len(gradient))
        across = self._white.T @ information[:, shape]
        left = information[np.ix_(shape, shape)] - across.T @ across
        values, vectors = np.linalg.eigh(left)
        seen = values > SEEN * max(float(values[-1]), float(np.trace(information[-size:, -size:])) * SEEN)
        score = (vectors.T @ gradient[shape])[seen]
        chi_square = float(np.sum(score**2 / values[seen]))
        return probability_of(chi_square, int(seen.sum())) < SIGNIFICANT

    def contradiction(self) -> str:
        """Return how angular velocity contradicts all else, or nothing."""
        sizes = difference(self._white, self._own.information, self._own.gradient)
        words = "look at its stamps and axes, and at whether the field is uniform"
        return f"the angular velocity contradicts the readings, {sizes}: {words}" if sizes else ""

    def remarks(self) -> tuple[str, ...]:
        """Return how the gyroscope is late and turned, and what its scale may do, in a sentence each."""
        from scipy.spatial.transform import Rotation

        information, _ = self._all
        covariance = inverted(information, self.problem.basis_at(self.place))
        errors = np.sqrt(np.diag(covariance))[-self.state.size :]
        count, notes = self.state.bias.size, []
        if abs(self.state.delay_s) > max(_FAR * errors[count], _LATE * self.use.interval_s):
            late = "late" if self.state.delay_s > 0 else "early"
            notes.append(f"the angular velocity is {abs(self.state.delay_s):.3g} s {late}, which is taken off")
        turn = float(norm(Rotation.from_matrix(self.state.mount).as_rotvec()))
        if turn > max(_FAR * float(norm(errors[count + 1 : count + 4])), _ASKEW):
            notes.append(f"the gyroscope is turned by {to_degrees(turn):.2g}° against sensor 1, which is estimated")
        # A scale error of all axes moves the errors of the sensors by so much.
        shift = -covariance @ information[:, -6:-3].sum(axis=1)
        biases = np.arange(12 * self.place.errors.sensor_count).reshape(-1, 12)[:, 6:9].ravel()
        moved_nT = _TYPICAL_SCALE * to_nanotesla(float(norm(shift[biases])))
        if not self.use.shape_error and moved_nT > to_nanotesla(
            float(np.sqrt(np.trace(covariance[biases][:, biases])))
        ):
            notes.append(
                f"the gyroscope's scale is taken for true: {100 * _TYPICAL_SCALE:g} % of it would move the biases by "
                f"{moved_nT:.2g} nT; state scale_error_percent"
            )
        return tuple(notes)
