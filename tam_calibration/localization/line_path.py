"""The path of a platform from its navigation: a smooth curve, and how far it may be from the true path.

Navigation errs by white noise and by a slow drift, and a platform moves smoothly. So recorded positions are fitted by a
cubic spline whose velocity changes as a random walk, of the size that makes the positions likeliest. The error of the
path is the same spline with coefficients of known covariance: that of the fit, and that of the drift.
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

_STEP_S, _FINER_STEPS_S = 0.8, (0.4, 0.2)
"""Distances between knots, seconds: vehicles sway within some seconds. A finer one is taken where it halves the
variance that a curve leaves of the positions, as it does where they are exact to millimetres."""

_MARGIN = 12
"""Knots beside a part of the path that tell of the errors in it."""

_BALANCES = 10.0 ** np.arange(-6.0, 7.5, 0.5)
"""Ratios of the white variance to that of the random walk that are tried."""

_LEAST_WHITE_M = 1e-5
"""Least standard deviation of the white error, metres: navigation is written in digits."""

_WALK_M_PER_S2, _SWAY_M = 0.05, 0.2
"""Standard deviations of a platform's acceleration, m/s², and of its distance from a straight line, metres, where no
navigation tells them."""

DRIFT_TIMES = (0.05, 0.3, 3.0)
"""Correlation times of a drift, as parts of the line, each with a part of its variance."""

_PARTS = (0.04, 0.5, 0.46)
"""Parts of the variance of a drift, by its correlation times."""

_LEAST_ERROR_M = 1e-3
"""Least standard deviation of the error of a path, metres: frames are not measured better."""

_LEAST_SEEN_M = 2e-4
"""Standard deviation below which a part of the error of a path is left out, metres."""


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

    def four(self, at: FloatArray) -> tuple[np.ndarray, FloatArray]:
        """Return which coefficients (N, 4) count at abscissas (N,), and their values (N, 4): others are zero."""
        centers = self.centers
        first = np.clip(np.floor((at - centers[0]) / self.step).astype(int) - 1, 0, self.count - 4)
        index = first[:, None] + np.arange(4)
        return index, _cubic(np.abs(at[:, None] - centers[index]) / self.step)

    def matrix(self, at: FloatArray) -> FloatArray:
        """Return the values (N, count) of the basis at abscissas (N,)."""
        return _cubic(np.abs(np.asarray(at)[:, None] - self.centers) / self.step)


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
        index, values = self.basis.four(time_s)
        return np.asarray(np.einsum("nc,nci->ni", values, self.coefficients_m[index]))

    def error(self, first_s: float, last_s: float) -> tuple[slice, list[FloatArray]]:
        """Return which coefficients (n) are used between two times, and the roots (n, ·) of each axis' covariance."""
        centers, step = self.basis.centers, self.basis.step
        low, high = first_s - 2 * step, last_s + 2 * step
        wide = np.flatnonzero((centers > low - _MARGIN * step) & (centers < high + _MARGIN * step))
        used = np.flatnonzero((centers[wide] > low) & (centers[wide] < high))
        times = centers[wide[used]]
        span = float(centers[-1] - centers[0])
        lag = np.abs(times[:, None] - times)
        drift = sum(part * np.exp(-lag / (span * scale)) for part, scale in zip(_PARTS, DRIFT_TIMES, strict=True))
        since = times - centers[0]
        slow = (self.drift_m**2 + _LEAST_ERROR_M**2) * drift + self.velocity_error_m_per_s**2 * np.outer(since, since)
        roots = []
        for bands in self.precision:
            own = np.diag(bands[3, wide])
            for away in range(1, 4):
                diagonal = bands[3 - away, wide[away:]]
                own += np.diag(diagonal, away) + np.diag(diagonal, -away)
            values, vectors = np.linalg.eigh(np.linalg.inv(own)[np.ix_(used, used)] + slow)
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
        When there are fewer than four positions.
    """
    is_new = np.asarray(np.isfinite(position_m).all(axis=1))
    is_new[1:] &= (position_m[1:] != position_m[:-1]).any(axis=1)
    times, places = time_s[is_new], position_m[is_new]
    if len(times) < 4:
        raise InputError(f"the recording has {len(times)} different positions, and a line needs four: record them")
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
    from scipy.linalg import cho_solve_banded, cholesky_banded

    index, values = basis.four(times)
    rows, rough = _bands(index, values, basis.count), _roughness(basis.count)
    best, least = None, np.inf
    centred = places - places.mean()
    right = np.bincount(index.ravel(), (values * centred[:, None]).ravel(), basis.count)
    for balance in _BALANCES:
        bands = rows + balance * rough
        bands[3] += 1e-10 * rows[3].mean()
        root = cholesky_banded(bands)
        coefficients = cho_solve_banded((root, False), right)
        residual = centred - np.sum(values * coefficients[index], axis=1)
        energy = float(residual @ centred) / (len(places) - 2)
        variance = max(energy, error_m**2, _LEAST_WHITE_M**2)
        score = (len(places) - 2) * (np.log(variance) + energy / variance)
        score += 2 * float(np.sum(np.log(root[3]))) - (len(rough[3]) - 2) * np.log(balance)
        if score < least:
            least, best = score, (variance, coefficients + places.mean(), bands / variance)
    assert best is not None
    return best


def _bands(index: np.ndarray, values: FloatArray, count: int) -> FloatArray:
    """Return the upper bands (4, C) of the products of a basis at N abscissas, the diagonal last."""
    bands = np.zeros((4, count))
    for away in range(4):
        products = values[:, away:] * values[:, : 4 - away]
        bands[3 - away] = np.bincount(index[:, away:].ravel(), products.ravel(), count)
    return bands


def _roughness(count: int) -> FloatArray:
    """Return the upper bands (4, C) of the squares of second differences 1, -2, 1."""
    bands = np.zeros((4, count))
    bands[3, :-2] += 1
    bands[3, 1:-1] += 4
    bands[3, 2:] += 1
    bands[2, 1:-1] -= 2
    bands[2, 2:] -= 2
    bands[1, 2:] += 1
    return bands


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
    bands[3] += 1 / (_SWAY_M if error_m_per_s else _LEAST_ERROR_M) ** 2
    return Path(basis, places, np.array([bands] * 3), 0.0, error_m_per_s)


def _cubic(distance: FloatArray) -> FloatArray:
    """Return the cubic B-spline at distances from its middle, in steps of its knots."""
    near = 2 / 3 - distance**2 + distance**3 / 2
    return np.where(distance < 1, near, np.maximum(2 - distance, 0.0) ** 3 / 6)
