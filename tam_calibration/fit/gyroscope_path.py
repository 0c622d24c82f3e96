"""The turns of an array between its samples, as a gyroscope measured them.

The angular velocity ω is a cubic spline through its readings; its integral over the interval between two samples, less
that of the bias, is the turn φ. An angular velocity whose direction changes adds Δt²/12 ω₁ × ω₂ to it (the coning
correction of two samples, Savage 1998). The frame of the gyroscope is that of the sensors after the turn X and the
symmetric matrix S, which holds what its axes differ by in scale and angle: in their frame the turn is X S φ.

Where the fit of a gyroscope begins: its unit, how it is mounted and how late it is, from the field that it turns.

Over a short time the direction u of the field changes by u × ψ, with ψ = M φ, where φ is the integral of the angular
velocity less that of a bias. The sum of squares is quadratic in M and the bias; its delay is tried, and M is a multiple
of a rotation. A multiple of a mirrored rotation that fits better shows axes that are left-handed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import fast_noise
from tam_calibration.fit.ellipsoid import COLUMNS, ROWS
from tam_calibration.model.mounting import rotation_matrix
from tam_calibration.model.sensor_errors import ORIENTATIONS
from tam_calibration.model.units import FloatArray, from_degrees


@dataclass(frozen=True, eq=False)
class GyroscopeState:
    """What a fit finds of a gyroscope.

    Parameters
    ----------
    bias : (1 + M, 3) array
        Constant bias and amplitudes of its M cosines of time, in the frame of the gyroscope, rad/s.
    delay_s : float
        How much later than it was measured an angular velocity is stamped.
    mount : (3, 3) array
        X: rotation from the frame of the gyroscope to that of the sensors.
    shape : (3, 3) array
        S: symmetric.
    """

    bias: FloatArray
    delay_s: float
    mount: FloatArray
    shape: FloatArray

    @classmethod
    def at_rest(cls, mount: FloatArray, delay_s: float) -> "GyroscopeState":
        """Return a gyroscope without bias and with true axes."""
        return cls(np.zeros((1, 3)), delay_s, mount, np.eye(3))

    def of_modes(self, modes: int) -> "GyroscopeState":
        """Return the state with so many cosines of the bias: those that it has, then none."""
        kept = self.bias[: 1 + modes]
        return replace(self, bias=np.vstack([kept, np.zeros((1 + modes - len(kept), 3))]))

    @property
    def turn(self) -> slice:
        """Place of the turn of X among the unknowns."""
        return slice(self.size - 9, self.size - 6)

    @property
    def mounting(self) -> tuple[FloatArray, float]:
        """Rotation from the frame of the sensors to that of the gyroscope, and its turn over that of X."""
        return self.mount.T, -1.0

    @property
    def size(self) -> int:
        """Number of unknowns: those of the bias, the delay, three of the turn of X, and six of S."""
        return self.bias.size + 10

    def moved(self, step: FloatArray) -> "GyroscopeState":
        """Return the state after a step (size,) of the unknowns, in the order of ``size``."""
        count, shape = self.bias.size, self.shape.copy()
        shape[ROWS, COLUMNS] += step[count + 4 :]
        shape[COLUMNS, ROWS] = shape[ROWS, COLUMNS]
        return replace(
            self,
            bias=self.bias + step[:count].reshape(-1, 3),
            delay_s=self.delay_s + float(step[count]),
            mount=rotation_matrix(step[count + 1 : count + 4]) @ self.mount,
            shape=shape,
        )


@dataclass(frozen=True, eq=False)
class GyroscopeUse:
    """How the angular velocity of a recording counts.

    Parameters
    ----------
    density : float
        One-sided density of its noise, rad/s/√Hz.
    bias_error : float
        Standard deviation of the constant bias about zero, rad/s; that of its n-th cosine is as much over n.
    interval_s : float
        Usual interval of the samples: where samples were left out, nothing is known of the turn.
    start : GyroscopeState
        Where the fit begins.
    shape_error : float
        Standard deviation of the elements of ``GyroscopeState.shape``; 0 where the axes are true.
    lasting : float
        By how much what it tells varies more than by white noise.
    stride : int
        Over how many samples its turns are taken: more than one makes a fit quicker, and hardly less accurate.
    jitter_s : float
        Standard deviation of the stamps: while the array turns, a reading is of another direction by that time.
    """

    density: float
    bias_error: float
    interval_s: float
    start: GyroscopeState
    shape_error: float = 0.0
    lasting: float = 1.0
    stride: int = 1
    jitter_s: float = 0.0


@dataclass(frozen=True, eq=False)
class GyroscopePath:
    """The angular velocities of a recording.

    Parameters
    ----------
    time_s : (N,) array
        Of the samples, seconds.
    rates : (N, 3) array
        Angular velocities in the frame of the gyroscope, rad/s; NaN where there is none.
    interval_s : float
        Usual interval of the samples.
    span_s : tuple of two floats
        First and last time over which the bias wanders.
    delay_s : float
        By which readings are late, nearly: they must be known at the times of the samples and that.
    stride : int
        How many usual intervals are one: more than one where only slow noise shall show.
    """

    time_s: FloatArray
    rates: FloatArray
    interval_s: float
    span_s: tuple[float, float]
    delay_s: float = 0.0
    stride: int = 1

    def part(self, samples: slice) -> "GyroscopePath":
        """Return the path of some of the samples; the courses of the bias stay."""
        return replace(self, time_s=self.time_s[samples], rates=self.rates[samples])

    @cached_property
    def _is_known(self) -> np.ndarray:
        """(N - 1,) whether the turn between two samples is known."""
        known = np.asarray(np.isfinite(self.rates).all(axis=1))
        # Interval over the usual one from which samples between are missing: what the array did there is not
        # known.
        is_short = np.asarray(np.diff(self.time_s) < 1.5 * self.interval_s)
        # Readings must be known on both sides of the moment at which that of a sample was stamped, or at it.
        at_s = self.time_s + self.delay_s
        after = np.searchsorted(self.time_s, at_s)
        between = np.clip(after - 1, 0, len(is_short) - 1)
        is_told = np.asarray((known[:-1] & known[1:] & is_short)[between] & (after - 1 == between))
        for neighbour in (between, between + 1):
            # Part of an interval within which a reading is that of a moment.
            is_told |= known[neighbour] & (np.abs(self.time_s[neighbour] - at_s) < 0.02 * self.interval_s)
        return np.asarray(is_told[:-1] & is_told[1:] & is_short)

    @cached_property
    def links(self) -> np.ndarray:
        """(L,) intervals of which the turn is known, by their number: the i-th begins at sample i times the stride."""
        count = len(self._is_known) // self.stride
        return np.flatnonzero(self._is_known[: count * self.stride].reshape(count, -1).all(axis=1))

    @property
    def follows(self) -> np.ndarray:
        """(L - 1,) whether an interval begins where the one before ends."""
        return np.asarray(np.diff(self.links) == 1)

    @cached_property
    def duration_s(self) -> FloatArray:
        """(L,) durations of the intervals."""
        return np.asarray(np.diff(self.time_s[:: self.stride])[self.links])

    @property
    def modes(self) -> int:
        """Number of cosines that describe how the bias wanders."""
        # 100.0 and 6: time in which a bias may wander there and back at most, and the most cosines that describe it.
        return min(6, int((self.span_s[1] - self.span_s[0]) / 100.0))

    @cached_property
    def courses(self) -> FloatArray:
        """(1 + M, L) courses of the bias: constant, and slow cosines."""
        return self._courses(self.time_s[:: self.stride][self.links] + self.duration_s / 2)

    @cached_property
    def _courses_between(self) -> FloatArray:
        """(1 + M, N - 1) the same between all samples."""
        return self._courses(self.time_s[:-1] + np.diff(self.time_s) / 2)

    def _courses(self, time_s: FloatArray) -> FloatArray:
        first_s, last_s = self.span_s
        phase = np.pi * (time_s - first_s) / max(last_s - first_s, self.interval_s)
        return np.cos(np.arange(1 + self.modes)[:, None] * phase)

    @cached_property
    def _spline(self) -> tuple[Any, Any]:
        """The angular velocity and its integral as functions of time."""
        from scipy.interpolate import CubicSpline

        known = np.isfinite(self.rates).all(axis=1)
        rates = CubicSpline(self.time_s[known], self.rates[known])
        return rates, rates.antiderivative()

    def integral(self, time_s: FloatArray) -> FloatArray:
        """Return the integral (n, 3) of the readings up to times (n,), radians."""
        return np.asarray(self._spline[1](time_s))

    @cached_property
    def _measured(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Angular velocity (N, 3) at the nearly right times, its integrals (N - 1, 3), and its change without noise."""
        known = np.isfinite(self.rates).all(axis=1)
        at_s = np.clip(self.time_s + self.delay_s, *self.time_s[known][[0, -1]])
        velocity = steady = np.asarray(self._spline[0](at_s))
        noise = float(np.sum(fast_noise(self.rates[known]) ** 2))
        # (2, 4, 8, 16, 32) and 1.5: intervals over whose mean an angular velocity may be taken for the derivative by
        # the delay, and what that may take off it, over the variance of its noise. A reading's own noise looks like a
        # delay where the array turns steadily.
        for count in (2, 4, 8, 16, 32):
            half_s = count * self.interval_s / 2
            ends = (np.clip(at_s + side, at_s[0], at_s[-1]) for side in (half_s, -half_s))
            last_s, first_s = ends
            mean = (self.integral(last_s) - self.integral(first_s)) / (last_s - first_s)[:, None]
            if float(np.mean(np.sum((velocity - mean)[known] ** 2, axis=1))) > 1.5 * noise:
                break
            steady = mean
        return velocity, np.diff(self.integral(at_s), axis=0), np.diff(steady[:: self.stride], axis=0)

    @property
    def by_delay(self) -> FloatArray:
        """(L, 3) derivatives of the turns by the delay, rad/s: without the readings' noise, which looks like turns."""
        return np.asarray(self._measured[2][self.links])

    def turns(self, state: GyroscopeState) -> FloatArray:
        """Return the turns (L, 3) φ of the intervals in the gyroscope's frame, rotation vectors, radians.

        Parameters
        ----------
        state : GyroscopeState
            Its bias and delay count.
        """
        velocity, integral, _ = self._measured
        duration_s = np.diff(self.time_s)[:, None]
        bias = self._courses_between.T @ state.bias
        angle = integral - bias * duration_s
        angle += np.cross(velocity[:-1] - bias, velocity[1:] - bias) * duration_s**2 / 12
        return np.asarray(self._combined(angle)[self.links] + (state.delay_s - self.delay_s) * self.by_delay)

    def _combined(self, angle: FloatArray) -> FloatArray:
        """Return the turns over strides: turns that follow each other, to second order in them."""
        count = len(angle) // self.stride
        parts = angle[: count * self.stride].reshape(count, self.stride, 3)
        before = np.cumsum(parts, axis=1) - parts
        return np.asarray((parts + np.cross(before, parts) / 2).sum(axis=1))


_TRIED, _STEPS = 4, 12
"""Rotations by right angles, the best of all 24, from which the fit begins, and its steps."""


_RIDGE = 1e-6
"""Part of the information that is added: it decides where the changes tell nothing."""

UNITS = {"rad/s": 1.0, "°/s": from_degrees(1.0)}
"""Units that are recognised by the size of the readings, in rad/s."""


@dataclass(frozen=True, eq=False)
class Match:
    """How a gyroscope goes with the field.

    Parameters
    ----------
    unit : str
        Of its readings, one of ``UNITS``.
    mount : (3, 3) array
        Rotation from its frame to that of the sensors.
    delay_s : float
        How much later than it was measured its reading is stamped.
    reason : str
        Why it cannot be used; empty where it can.
    """

    unit: str
    mount: FloatArray
    delay_s: float
    reason: str = ""


def matched(along: FloatArray, path: GyroscopePath) -> Match:
    """Return how angular velocities go with the directions of the field.

    Parameters
    ----------
    along : (N, 3) array
        Directions of the field in the frame of the sensors, unit vectors.
    path : GyroscopePath
        The angular velocities.
    """
    before, after, turns = _changes(along, path)
    by_turn = np.cross((before + after)[:, None] / 2, np.eye(3))  # (n, i, 3): the change by a turn about axis i
    change = (after - before).T.ravel()
    # np.linspace(-1.0, 1.0, 81): delays that are tried, seconds.
    tried = [_Quadratic.of(by_turn, change, turns(delay_s), float(delay_s)) for delay_s in np.linspace(-1.0, 1.0, 81)]
    best = min(tried, key=lambda quadratic: quadratic.least)
    (cost, scale, mount), (mirrored, _, _) = best.rotation(1.0), best.rotation(-1.0)
    unit = min(UNITS, key=lambda name: abs(np.log(scale / UNITS[name])))
    match = Match(unit, mount, best.delay_s)
    # Part of the changes of the field that the angular velocity must explain.
    if min(cost, mirrored) > (1 - 0.5) * best.square:
        return replace(match, reason="the angular velocity does not go with the turns of the field")
    # Sum of squares of a mirrored rotation over that of a rotation from which axes are left-handed.
    if mirrored < 0.5 * cost:
        return replace(
            match, reason="the field turns as if the axes of the gyroscope or of the sensors were left-handed"
        )
    # Factor by which the size of the readings may miss that of their unit; degrees are 57 times as many as radians.
    unit_error = 1.5
    if not 1 / unit_error < scale / UNITS[unit] < unit_error:
        return replace(match, reason=f"the field turns {scale:.3g} times as far as the angular velocity in rad/s says")
    return match


def _changes(along: FloatArray, path: GyroscopePath) -> tuple[FloatArray, FloatArray, Callable[[float], FloatArray]]:
    """Return fields (n, 3) before and after some changes, and what returns the integrals (n, 4) of rates and 1."""
    count = len(along)
    steps = np.array([1, 2, 5, 10, 20, 50, 100, 200])
    steps = steps[steps <= max(count // 10, 1)]
    chords = [np.sqrt(np.mean(np.sum((along[step:] - along[:-step]) ** 2, axis=1))) for step in steps]
    # Turn of the field over which changes are compared, radians: far above the noise, and nearly linear.
    step = int(steps[min(int(np.searchsorted(np.maximum.accumulate(chords), 0.05)), len(steps) - 1)])
    first = path.links[path.links < count - step]
    first = first[np.isin(first + step - 1, path.links)]
    # Changes that are compared.
    first = first[:: len(first) // 4000 + 1]
    last = first + step

    def turns(delay_s: float) -> FloatArray:
        turned = path.integral(path.time_s[last] + delay_s) - path.integral(path.time_s[first] + delay_s)
        return np.column_stack([turned, path.time_s[last] - path.time_s[first]])

    return along[first], along[last], turns


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """The sum of squares m·H m - 2 g·m + s over the rows m of M, the bias eliminated."""

    normal: FloatArray
    slope: FloatArray
    square: float
    delay_s: float

    @classmethod
    def of(cls, by_turn: FloatArray, change: FloatArray, turns: FloatArray, delay_s: float) -> "_Quadratic":
        columns = np.einsum("nix,nj->xnij", by_turn, turns).reshape(3 * len(turns), 3, 4)
        rates, bias = columns[:, :, :3].reshape(-1, 9), columns[:, :, 3]
        basis, _ = np.linalg.qr(bias)
        rates, change = rates - basis @ (basis.T @ rates), change - basis @ (basis.T @ change)
        return cls(rates.T @ rates, rates.T @ change, float(change @ change), delay_s)

    @property
    def least(self) -> float:
        """The sum of squares of any M."""
        ridged = self.normal + _RIDGE * np.trace(self.normal) * np.eye(9)
        return self.square - float(self.slope @ np.linalg.solve(ridged, self.slope))

    def rotation(self, sign: float) -> tuple[float, float, FloatArray]:
        """Return the least sum of squares of a multiple of a rotation, or of a mirrored one, and scale and rotation."""
        found = []
        ridge = _RIDGE * float(np.trace(self.normal))
        starts = ORIENTATIONS.reshape(-1, 9)
        along = np.maximum(sign * starts @ self.slope, 0.0)
        size = np.einsum("ti,ij,tj->t", starts, self.normal, starts) + ridge
        for start in np.argsort(-(along**2) / size)[:_TRIED]:
            turn, scale = ORIENTATIONS[start], max(float(along[start] / size[start]), _RIDGE)
            for _ in range(_STEPS):
                matrix = sign * scale * turn
                away = self.slope - self.normal @ matrix.ravel()
                by_turn = [np.cross(axis, matrix, axisb=0, axisc=0).ravel() for axis in np.eye(3)]
                columns = np.column_stack([*by_turn, matrix.ravel()])
                normal = columns.T @ self.normal @ columns + ridge * scale**2 * np.eye(4)
                step = np.linalg.solve(normal, columns.T @ away)
                turn = rotation_matrix(step[:3] / max(1.0, float(norm(step[:3])))) @ turn
                scale *= float(np.exp(np.clip(step[3], -1, 1)))
            matrix = (sign * scale * turn).ravel()
            cost = self.square - 2 * float(self.slope @ matrix) + float(matrix @ self.normal @ matrix)
            # Of rotations that fit as well, the least one.
            found.append((cost + ridge * scale**2 * float(norm(turn - np.eye(3)) ** 2), cost, scale, turn))
        _, cost, scale, turn = min(found, key=lambda each: each[0])
        return cost, scale, turn
