"""The course of a platform along a survey line: its path from navigation, its attitude also from a gyroscope.

Navigation errs by white noise and by a slow drift, and a platform moves smoothly. So recorded positions are fitted by a
cubic spline whose velocity changes as a random walk, of the size that makes the positions likeliest. The error of the
path is the same spline with coefficients of known covariance: that of the fit, and that of the drift.

The turns that a gyroscope measured, one after the other, are an attitude G whose error grows slowly. The recorded
attitude R has an error of constant size that lasts for seconds. With A the true attitude, the small rotations

    c = log(A Gᵀ),    log(R Gᵀ) = c + error of R

are fitted by least squares: c is constant but for what bias, delay, mounting and scale of the gyroscope make of the
turns, and for the random walk that its noise makes, as the first terms of its Karhunen-Loève series.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import inv
from scipy.linalg import cho_solve_banded, cholesky_banded, solveh_banded
from scipy.spatial.transform import Rotation

from tam_calibration.core.noise import fast_noise
from tam_calibration.fit.ellipsoid import COLUMNS, ROWS
from tam_calibration.fit.gyroscope_path import GyroscopePath, GyroscopeState
from tam_calibration.localization.source_fit import PLACE_ERROR_M
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.sensor_errors import crossing
from tam_calibration.model.units import FloatArray, from_degrees, rounded, to_degrees

_STEP_S, _FINER_STEPS_S = 0.8, (0.4, 0.2)
"""Distances between knots, seconds: vehicles sway within some seconds. A finer one is taken where it halves the
variance that a curve leaves of the positions, as it does where they are exact to millimetres."""

_MARGIN = 12
"""Knots beside a part of the path that tell of the errors in it."""

_BALANCES = 10.0 ** np.arange(-6.0, 7.5, 0.5)
"""Ratios of the white variance to that of the random walk that are tried."""

_WALK_M_PER_S2, _SWAY_M = 0.05, 0.2
"""Standard deviations of a platform's acceleration, m/s², and of its distance from a straight line, metres, where no
navigation tells them."""

_DRIFT = {0.05: 0.04, 0.3: 0.5, 3.0: 0.46}
"""Parts of the variance of a drift by their correlation times, which are parts of the line."""

_LEAST_SEEN_M = 2e-4
"""Standard deviation below which a part of the error of a path is left out, metres: positions are written in digits."""


@dataclass(frozen=True, eq=False)
class Basis:
    """A uniform cubic B-spline.

    Parameters
    ----------
    first : float
        Abscissa of the first knot.
    step : float
        Distance between knots.
    count : int
        Number of coefficients.
    """

    first: float
    step: float
    count: int

    @classmethod
    def over(cls, first: float, last: float, step: float) -> "Basis":
        """Return the basis between two abscissas, its knots at most so far apart."""
        intervals = max(1, int(np.ceil((last - first) / step)))
        return cls(first, max(last - first, 1e-9) / intervals, intervals + 3)

    @property
    def centers(self) -> FloatArray:
        """(count,) abscissas of the maxima."""
        return np.asarray(self.first + self.step * (np.arange(self.count) - 1))

    def rows(self, at: FloatArray) -> Any:
        """Return the values of the basis at abscissas (N,) as a sparse matrix (N, count)."""
        from scipy.interpolate import BSpline

        knots = self.first + self.step * np.arange(-3, self.count + 1)
        return BSpline.design_matrix(at, knots, 3, extrapolate=True)  # by rounding they may lie beyond the last knot

    def matrix(self, at: FloatArray) -> FloatArray:
        """Return the values (N, count) of the basis at abscissas (N,)."""
        return np.asarray(self.rows(at).toarray())


@dataclass(frozen=True, eq=False)
class Path:
    """The path of an array's centre, and its errors.

    Parameters
    ----------
    basis : Basis
        Of the spline, over time in seconds.
    coefficients_m : (C, 3) array
        Of the path, metres.
    precision : (3, 4, C) array
        Bands of the precision of each axis' coefficients beside the drift, the diagonal last, 1/m².
    drift_m : float
        Standard deviation of the drift, metres.
    velocity_error_m_per_s : float
        Standard deviation of a constant velocity that positions were reckoned by, m/s.
    """

    basis: Basis
    coefficients_m: FloatArray
    precision: FloatArray
    drift_m: float
    velocity_error_m_per_s: float = 0.0

    def at(self, time_s: FloatArray) -> FloatArray:
        """Return the path (N, 3) at times (N,), metres."""
        return np.asarray(self.basis.rows(time_s) @ self.coefficients_m)

    def error(self, first_s: float, last_s: float) -> tuple[slice, list[FloatArray]]:
        """Return which coefficients (n) are used between two times, and the roots (n, ·) of each axis' covariance."""
        centers, step = self.basis.centers, self.basis.step
        low, high = first_s - 2 * step, last_s + 2 * step
        wide = np.flatnonzero((centers > low - _MARGIN * step) & (centers < high + _MARGIN * step))
        used = np.flatnonzero((centers[wide] > low) & (centers[wide] < high))
        times = centers[wide[used]]
        span = float(centers[-1] - centers[0])
        lag = np.abs(times[:, None] - times)
        drift = sum(part * np.exp(-lag / (span * scale)) for scale, part in _DRIFT.items())
        since = times - centers[0]
        slow = (self.drift_m**2 + PLACE_ERROR_M**2) * drift + self.velocity_error_m_per_s**2 * np.outer(since, since)
        roots = []
        for bands in self.precision:
            own = solveh_banded(bands[:, wide], np.eye(len(wide)))
            values, vectors = np.linalg.eigh(own[np.ix_(used, used)] + slow)
            seen = values * step > _LEAST_SEEN_M**2 * _STEP_S
            roots.append(vectors[:, seen] * np.sqrt(values[seen]))
        return slice(int(wide[used[0]]), int(wide[used[-1]]) + 1), roots


def path_of(time_s: FloatArray, position_m: FloatArray, error_m: float | None = None, drift_m: float = 0.0) -> Path:
    """Return the path that recorded positions show.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    position_m : (N, 3) array
        Positions, metres; NaN where there is none. A position that is repeated counts where it came first.
    error_m : float, optional
        Least standard deviation of their white error; they may show a larger one.
    drift_m : float
        Standard deviation of their slow error over the line.

    Raises
    ------
    InputError
        When there are fewer than four positions, or they move faster than a platform does.
    """
    is_new = np.asarray(np.isfinite(position_m).all(axis=1))
    is_new[1:] &= (position_m[1:] != position_m[:-1]).any(axis=1)
    times, places = time_s[is_new], position_m[is_new]
    if len(times) < 4:
        raise InputError(f"the recording has {len(times)} different positions, and a line needs four: record them")
    speed = float(np.linalg.norm(np.ptp(places, axis=0)) / (times[-1] - times[0]))
    if speed > 150.0:  # metres per second: no aircraft surveys as fast
        raise InputError(f"the positions move at {rounded(speed)} m/s: state them in metres")
    least = 2 * float(time_s[-1] - time_s[0]) / len(times)
    best, chosen = np.inf, None
    for step in [max(_STEP_S, least), *(step for step in _FINER_STEPS_S if step > least)]:
        basis = Basis.over(float(time_s[0]), float(time_s[-1]), step)
        fits = [_smoothed(basis, times, places[:, axis], error_m or 0.0) for axis in range(3)]
        variances, coefficients, precision = (np.array(part) for part in zip(*fits, strict=True))
        if np.prod(variances) < best / 2**3:
            best, chosen = float(np.prod(variances)), Path(basis, coefficients.T, precision, drift_m)
    assert chosen is not None
    return chosen


def _smoothed(
    basis: Basis, times: FloatArray, places: FloatArray, error_m: float
) -> tuple[float, FloatArray, FloatArray]:
    """Return the variance of places (N,) about a smooth curve, its coefficients (C,), and their precision.

    The precision is in bands (4, C). The velocity changes as a random walk of the size at which the places are
    likeliest.
    """
    rows = basis.rows(times)
    own, rough = _bands(rows.T @ rows), _roughness(basis.count)
    best, least = None, np.inf
    centred = places - places.mean()
    right = rows.T @ centred
    for balance in _BALANCES:
        bands = own + balance * rough
        bands[3] += 1e-10 * own[3].mean()
        root = cholesky_banded(bands)
        coefficients = cho_solve_banded((root, False), right)
        residual = centred - rows @ coefficients
        energy = float(residual @ centred) / (len(places) - 2)
        variance = max(energy, error_m**2, _LEAST_SEEN_M**2)
        score = (len(places) - 2) * (np.log(variance) + energy / variance)
        score += 2 * float(np.sum(np.log(root[3]))) - (len(rough[3]) - 2) * np.log(balance)
        if score < least:
            least, best = score, (variance, coefficients + places.mean(), bands / variance)
    assert best is not None
    return best


def _bands(matrix: Any) -> FloatArray:
    """Return the upper bands (4, C) of a matrix (C, C), the diagonal last."""
    return np.array([np.pad(matrix.diagonal(away), (away, 0)) for away in (3, 2, 1, 0)])


def _roughness(count: int) -> FloatArray:
    """Return the upper bands (4, C) of the squares of second differences 1, -2, 1."""
    from scipy.sparse import diags

    second = diags([1.0, -2.0, 1.0], [0, 1, 2], shape=(count - 2, count))
    return _bands(second.T @ second)


def reckoned(time_s: FloatArray, velocity_m_per_s: FloatArray, error_m_per_s: float) -> Path:
    """Return the path of a platform that keeps its velocity but for a random walk about it; a walk of no error is none.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    velocity_m_per_s : (3,) array
        Velocity, m/s.
    error_m_per_s : float
        Standard deviation of each of its components.
    """
    basis = Basis.over(float(time_s[0]), float(time_s[-1]), _STEP_S)
    places = np.outer(basis.centers - basis.first, velocity_m_per_s)
    bands = _roughness(basis.count) / (_WALK_M_PER_S2 * basis.step**2) ** 2
    bands[3] += 1 / (_SWAY_M if error_m_per_s else PLACE_ERROR_M) ** 2
    return Path(basis, places, np.array([bands] * 3), 0.0, error_m_per_s)


_WALK = 24
"""Terms of the random walk for each axis: what they leave of its variance is a hundredth part of its end's."""

_MOUNTING, _SHAPE = from_degrees(3.0), 0.03
"""Standard deviations of a gyroscope's mounting, radians, and of its scales and angles, where none are stated."""

_DELAY_S = 0.1
"""Standard deviation of a gyroscope's delay, seconds."""

_LEAST_FREE = 0.25
"""Least share of the degrees of freedom that counts as left after the fit: few errors that last for long leave hardly
any, and their variance would grow without bound."""

_FAR = 3.0
"""Standard deviations of mounting, scale and angles beyond which the angular velocity is not that of this array."""

_WANDERS = 1.1
"""Ratio of the field's wander in the world with an angular velocity to that without, above which it is left out. A
right one made it 0.05 to 0.18 on twelve lines; where targets alone cause the wander it is 1."""


@dataclass(frozen=True, eq=False)
class AttitudePath:
    """The attitude of N samples.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    error : float
        Standard deviation about each axis, radians.
    note : str
        One sentence on what the angular velocity contributed; empty without one.
    """

    attitude: FloatArray
    error: float
    note: str = ""


def attitude_path(
    recording: Recording, gyroscope: Gyroscope | None, error: float, wander: Callable[[FloatArray], float]
) -> AttitudePath:
    """Return the attitude of a recording, steadied by its angular velocity where it has one that agrees.

    Parameters
    ----------
    recording : Recording
        Of N samples with attitude.
    gyroscope : Gyroscope, optional
        As the array file states it.
    error : float
        Stated standard deviation of the recorded attitude about each axis, radians; 0 where none is stated.
    wander : callable
        By how much the direction of the field wanders in the world of an attitude (N, 4), radians: with an angular
        velocity that agrees it wanders less.
    """
    assert recording.attitude is not None
    recorded = AttitudePath(recording.attitude, error)
    rates = recording.angular_velocity_rad_s
    if rates is None:
        return recorded
    if not _is_whole(recording.time_s, rates):
        return replace(recorded, note="the angular velocity has gaps or few samples, and is not used for the attitude")
    attitude = Rotation.from_quat(recording.attitude)
    known = _Gyroscope.of(recording.time_s, rates, gyroscope or Gyroscope()).with_bias_of(attitude)
    steadied, scatter = _fitted(attitude, known, error)
    if steadied is None or wander(steadied.attitude) > _WANDERS * wander(recorded.attitude):
        return replace(recorded, note="the angular velocity does not turn as the attitude does, and is not used")
    if steadied.error >= scatter:
        return recorded
    note = (
        f"the recorded attitude errs by {to_degrees(scatter):.2g}°, and by {to_degrees(steadied.error):.2g}° with the "
        "angular velocity"
    )
    return replace(steadied, note=note)


def _is_whole(time_s: FloatArray, rates: FloatArray) -> bool:
    """Return whether angular velocities (N, 3) determine all turns: enough samples, and gaps of a few at most."""
    # 100 samples: with fewer the noise is uncertain by more than a tenth.
    if len(time_s) < 100 or np.isfinite(rates).all(axis=1).mean() < 0.99:
        return False
    known_s = time_s[np.isfinite(rates).all(axis=1)]
    return bool(np.diff(known_s).max() < 5 * np.median(np.diff(time_s)))


@dataclass(frozen=True, eq=False)
class _Gyroscope:
    """The turns between N samples, and what is known of the gyroscope that measured them."""

    path: GyroscopePath
    density: float
    precision: FloatArray
    state: GyroscopeState

    @classmethod
    def of(cls, time_s: FloatArray, rates: FloatArray, stated: Gyroscope) -> "_Gyroscope":
        interval_s = float(np.median(np.diff(time_s)))
        known = np.isfinite(rates).all(axis=1)
        filled = np.column_stack([np.interp(time_s, time_s[known], each[known]) for each in rates.T])
        # With the longest interval for the usual one all turns are known.
        path = GyroscopePath(time_s, filled, float(np.diff(time_s).max()), (float(time_s[0]), float(time_s[-1])))
        state = GyroscopeState.at_rest(np.eye(3), 0.0).of_modes(path.modes)
        fast = float(np.sqrt(np.mean(fast_noise(filled) ** 2)) * np.sqrt(2 * interval_s))
        modes = np.maximum(np.arange(len(state.bias)), 1)
        shape = stated.scale_error or _SHAPE
        spread = np.array([*np.repeat(stated.bias / modes, 3), _DELAY_S, *[_MOUNTING] * 3, *[shape] * 6])
        return cls(path, stated.noise_density or fast, spread**-2, state)

    def with_bias_of(self, attitude: Rotation) -> "_Gyroscope":
        """Return the gyroscope with the constant bias by which its turns exceed those of an attitude (N,)."""
        turns = (attitude[:-1].inv() * attitude[1:]).as_rotvec()
        bias = self.state.bias.copy()
        bias[0] = (self.path.turns(self.state) - turns).sum(axis=0) / self.path.duration_s.sum()
        return replace(self, state=replace(self.state, bias=bias))

    def away(self) -> FloatArray:
        """Return how far (Q,) the state is from a gyroscope without errors."""
        state = self.state
        mounting = Rotation.from_matrix(state.mount).as_rotvec()
        shape = (state.shape - np.eye(3))[ROWS, COLUMNS]
        return np.concatenate([state.bias.ravel(), [state.delay_s], mounting, shape])

    def turned(self) -> tuple[Rotation, FloatArray]:
        """Return the rotations (N,) since the first sample, and their derivatives (N, 3, Q) in the world of these."""
        state, path = self.state, self.path
        matrix, angle = state.mount @ state.shape, path.turns(state)
        turns = angle @ matrix.T
        since = _products(Rotation.from_rotvec(np.vstack([np.zeros(3), turns])))
        by_bias = -np.einsum("ij,mn->nimj", matrix, path.courses * path.duration_s).reshape(len(turns), 3, -1)
        by_delay = (path.by_delay @ matrix.T)[:, :, None]
        by_mount = -crossing(turns)
        by_shape = state.mount[:, ROWS] * angle[:, None, COLUMNS]
        mirrored = state.mount[:, COLUMNS] * angle[:, None, ROWS]
        by_shape += np.where(ROWS == COLUMNS, 0.0, mirrored)
        own = np.concatenate([by_bias, by_delay, by_mount, by_shape], axis=2)
        moved = np.cumsum(since[1:].as_matrix() @ own, axis=0)
        return since, np.concatenate([np.zeros((1, *moved.shape[1:])), moved])

    def walk(self) -> tuple[FloatArray, float]:
        """Return the terms (N, J) of the walk that noise makes about an axis, radians, and the variance they leave."""
        since = self.path.time_s - self.path.time_s[0]
        rates = (np.arange(_WALK) + 0.5) * np.pi / since[-1]
        size = self.density / np.sqrt(2.0) * np.sqrt(2 / since[-1])
        terms = size * np.sin(np.outer(since, rates)) / rates
        whole = self.density**2 / 2 * float(since.mean())
        return terms, max(whole - float(np.mean(np.sum(terms**2, axis=1))), 0.0)


def _fitted(recorded: Rotation, known: _Gyroscope, error: float) -> tuple[AttitudePath | None, float]:
    """Return the attitude from both, or None where they disagree, and the recorded one's deviation from it, radians."""
    count = len(known.path.time_s)
    starts = np.arange(0, count, -(-count // BLOCK))  # the cost of the fit is bounded
    walk, rest = known.walk()
    of_walk = np.kron(_averaged(walk, starts)[:, None], np.eye(3))
    constant = np.broadcast_to(np.eye(3), (len(starts), 3, 3))
    size = len(known.precision)
    precision = np.concatenate([known.precision, np.ones(of_walk.shape[2]), np.zeros(3)])
    away = np.zeros(len(precision))
    first = recorded[0]
    scatter = max(error, 1e-6) ** 2
    # The attitude is linear in the unknowns but for products of them: it settles in a few steps.
    for _ in range(5):
        away[:size] = known.away()
        since, by_state = known.turned()
        made, by_state = first * since, first.as_matrix() @ by_state
        apart = (recorded * made.inv()).as_rotvec()
        rows, data = np.concatenate([_averaged(by_state, starts), of_walk, constant], axis=2), _averaged(apart, starts)
        flat = rows.reshape(-1, rows.shape[2])
        covariance = inv(flat.T @ flat / scatter + np.diag(precision))
        step = covariance @ (flat.T @ data.ravel() / scatter - precision * away)
        left = data - rows @ step
        lasting = _lasting(left)
        taken = float(np.sum(covariance * (flat.T @ flat))) / scatter * lasting / len(flat)
        scatter = max(float(np.mean(left**2)) * lasting / max(1.0 - taken, _LEAST_FREE), 1e-14)
        correction = by_state @ step[:size] + walk @ step[size:-3].reshape(-1, 3) + step[-3:]
        attitude = Rotation.from_rotvec(correction) * made
        known = replace(known, state=known.state.moved(step[:size]))
        first = Rotation.from_rotvec(step[-3:]) * first
    # With another mounting, scale or angles it is not the angular velocity of this array.
    if (np.abs(known.away()[-9:]) > _FAR / np.sqrt(known.precision[-9:])).any():
        return None, 0.0
    seen = float(np.mean((recorded * attitude.inv()).as_rotvec() ** 2))
    spread = np.einsum("nap,pq,naq->", rows, covariance, rows, optimize=True) / (3 * len(rows)) + rest
    return AttitudePath(attitude.as_quat(), float(np.sqrt(spread))), max(error, float(np.sqrt(seen)))


def _products(turns: Rotation) -> Rotation:
    """Return the products (N,) of rotations from the first to each."""
    product, reach = turns.as_quat(), 1
    while reach < len(product):
        product[reach:] = (Rotation.from_quat(product[:-reach]) * Rotation.from_quat(product[reach:])).as_quat()
        reach *= 2
    return Rotation.from_quat(product)


def _averaged(values: FloatArray, starts: np.ndarray) -> FloatArray:
    """Return the means of values (N, …) in blocks that begin at samples."""
    sizes = np.diff(np.append(starts, len(values)))
    return np.asarray(np.add.reduceat(values, starts, axis=0) / sizes.reshape(-1, *[1] * (values.ndim - 1)))


def _lasting(left: FloatArray) -> float:
    """Return the variance of sums of residuals (B, 3) over that of white ones: the autocorrelation up to its zero."""
    from scipy.fft import irfft, rfft

    count = len(left)
    power = np.sum(np.abs(rfft(left - left.mean(axis=0), 2 * count, axis=0)) ** 2, axis=1)
    correlation = irfft(power)[:count]
    correlation /= correlation[0]
    negative = np.flatnonzero(correlation <= 0.0)
    end = int(negative[0]) if len(negative) else count
    return max(1.0, 1.0 + 2.0 * float(np.sum(correlation[1:end])))
