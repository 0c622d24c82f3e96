"""The solution of a window of a line by steps of Levenberg and Marquardt."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import scaled
from tam_calibration.localization.line_window import Window
from tam_calibration.model.units import FloatArray

_MOST_STEPS, ROUGH_STEPS = 100, 8
"""Steps of a fit, and of one with a larger noise."""

LEAST_FALL, ROUGH_FALL = 0.02, 1.0
"""Fall of χ² below which they end."""

_FARTHEST_M, _STRONGEST_AM2, _LARGEST_ERROR = 150.0, 1e7, 30.0
"""Of dipoles from the middle of a window, of their moments, and of errors in units of their standard deviations."""

UNCOVERED = 2.0
"""Mean squared residual, over a noise, from which that noise does not cover what is left: something is missing."""

_MOST_STALLED = 3
"""Such steps in a row that end a fit, where damping has become large."""

_LEAST_SEEN = 0.1
"""Part of what is known of an error beforehand that the data must add for it to be fitted."""

_ROUGHNESSES = np.array([0.1, 0.2, 0.4, 0.7, 1.0])
"""Of a regional field that are tried. The least is 2 nT in 25 m: below it the gradient of far bodies changes."""

_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-5, 1e-9, 1e8
"""Of Levenberg's and Marquardt's steps, over the diagonal."""


@dataclass(frozen=True, eq=False)
class Solved:
    """The solution of a window.

    Parameters
    ----------
    window : Window
        The problem.
    unknowns : (P,) array
        Places and moments of the dipoles, then the others.
    chi_square : float
        Squares of the residuals and of what is expected of the unknowns.
    normal : (P, P) array
        Normal matrix near the solution.
    """

    window: Window
    unknowns: FloatArray
    chi_square: float
    normal: FloatArray

    @property
    def sources(self) -> FloatArray:
        """(S, 6) places and moments."""
        return self.window.divided(self.unknowns)[0]

    @property
    def others(self) -> FloatArray:
        """(n,) the unknowns beside the dipoles."""
        return self.window.divided(self.unknowns)[1]

    @cached_property
    def covariance(self) -> FloatArray:
        """(6 S, 6 S) of the dipoles, with all else marginalised."""
        unit, scale = scaled(self.normal)
        count = self.sources.size
        inverse = np.linalg.solve(unit + 1e-13 * np.eye(len(unit)), np.eye(len(unit))[:, :count])[:count]
        return np.asarray(inverse / scale[:count, None] / scale[:count])

    @property
    def covariances(self) -> FloatArray:
        """(S, 6, 6) of each dipole."""
        every = np.arange(len(self.sources))
        return self.covariance.reshape(len(every), 6, len(every), 6)[every, :, every]

    @cached_property
    def residual(self) -> FloatArray:
        """(M, 3 K - 2) residuals in units of their noise."""
        return self.window.linearized(self.unknowns, False)[0]


def annealed(window: Window, start: FloatArray) -> Solved:
    """Return the solution that begins with unknowns (P,) and with a larger noise, which falls tenfold each time.

    With little noise χ² is a narrow, bent valley that is followed by small steps only. Where a larger noise does not
    cover what is left, something is missing, and a smaller one tells no more of it.
    """
    size = float(np.sqrt(np.mean(window.linearized(start, False)[0] ** 2)))
    for factor in 10.0 ** np.arange(np.ceil(np.log10(max(size / 3, 1.0))), 0, -1):
        rough = replace(window, data=replace(window.data, noise_T=factor * window.data.noise_T))
        solved = solve(rough, start, ROUGH_STEPS, ROUGH_FALL)
        start = solved.unknowns
        if np.mean(solved.residual**2) > UNCOVERED:
            return solve(window, start, 1)
    return solve(window, start, least_fall=ROUGH_FALL)


def _limited(window: Window, unknowns: FloatArray, step: FloatArray) -> FloatArray:
    """Return a step (P,) with each dipole's part shortened to half its distance from the path, or so that it stays.

    Else one dipole that tells little, and flies off, holds up all the others.
    """
    limited = step.copy()
    (sources, _), (own, _) = window.divided(unknowns), window.divided(limited)
    distance = norm(sources[:, None, :3] - window.place_m, axis=2).min(axis=1)
    own *= np.minimum(1.0, 0.5 * distance / np.maximum(norm(own[:, :3], axis=1), 1e-300))[:, None]
    middle = window.place_m[len(window.place_m) // 2]
    own[norm(sources[:, :3] + own[:, :3] - middle, axis=1) > _FARTHEST_M, :3] = 0.0
    return limited


def _can_be(window: Window, unknowns: FloatArray) -> bool:
    """Return whether dipoles are in reach, and errors small: steps that are not are too long."""
    sources, others = window.divided(unknowns)
    middle = window.place_m[len(window.place_m) // 2]
    is_near = norm(sources[:, :3] - middle, axis=1) < _FARTHEST_M
    is_weak = norm(sources[:, 3:], axis=1) < _STRONGEST_AM2
    return bool(is_near.all() and is_weak.all() and (np.abs(others[: window.unit_count]) < _LARGEST_ERROR).all())


def solve(window: Window, start: FloatArray, most_steps: int = _MOST_STEPS, least_fall: float = LEAST_FALL) -> Solved:
    """Return the solution by steps of Levenberg and Marquardt.

    Parameters
    ----------
    start : (P,) array
        Places and moments of the dipoles, then the other unknowns.
    most_steps : int
        Steps at most.
    least_fall : float
        Fall of χ² below which a step is the last.
    """
    split = len(start) - window.nuisance_count
    known = window.known.size
    precision = np.zeros((len(start),) * 2)
    precision[split:, split:] = window.precision
    precision[range(known), range(known)] = window.known_precision
    expected = np.concatenate([window.known.ravel(), np.zeros(split - known), window.start()])
    unknowns, damping = start, _FIRST_DAMPING

    def cost(tried: FloatArray) -> float:
        if not _can_be(window, tried):
            return np.inf
        off, residual = tried - expected, window.linearized(tried, False)[0]
        return float(np.sum(residual**2) + off @ precision @ off)

    lowest, stalled = cost(unknowns), 0
    free = np.arange(len(start))
    for number in range(most_steps):
        residual, slopes = window.linearized(unknowns)
        rows = slopes.reshape(-1, len(start))
        if not number:  # errors that the data hardly see stay what they are
            seen = np.sum(rows**2, axis=0) > _LEAST_SEEN
            seen[:split] = seen[split + window.unit_count :] = True
            free = np.flatnonzero(seen)
        rows, inside = rows[:, free], precision[np.ix_(free, free)]
        normal = rows.T @ rows + inside
        slope = rows.T @ residual.ravel() - (precision @ (unknowns - expected))[free]
        (unit, scale), fall = scaled(normal), 0.0
        while damping < _LARGEST_DAMPING:
            step = np.zeros(len(start))
            step[free] = np.linalg.solve(unit + damping * np.eye(len(free)), slope / scale) / scale
            tried = unknowns + _limited(window, unknowns, step)
            reached = cost(tried)
            if reached < lowest:
                fall, lowest, unknowns = lowest - reached, reached, tried
                damping = max(damping / 5, _LEAST_DAMPING)
                break
            damping *= 3
        stalled = stalled + 1 if fall < least_fall else 0
        if stalled and (damping < _FIRST_DAMPING or stalled >= _MOST_STALLED):
            break
    return Solved(window, unknowns, lowest, normal)


def likeliest_roughness(solved: Solved) -> float:
    """Return the roughness of the regional field at which the data of a window are likeliest, to first order."""
    residual, slopes = solved.window.linearized(solved.unknowns)
    rows, left = slopes.reshape(-1, slopes.shape[2]), residual.ravel()
    normal, slope = rows.T @ rows, rows.T @ left
    others = slice(solved.sources.size, None)
    off = solved.others - solved.window.start()
    scores = []
    for roughness in _ROUGHNESSES:
        window = replace(solved.window, roughness=float(roughness))
        prior = window.prior
        total, gradient = normal.copy(), slope.copy()
        total[others, others] += prior.T @ prior
        gradient[others] -= prior.T @ (prior @ off)
        unit, scale = scaled(total)
        unit += 1e-13 * np.eye(len(total))
        fall = gradient / scale @ np.linalg.solve(unit, gradient / scale)
        cost = left @ left + np.sum((prior @ off) ** 2) - fall
        freedom = np.linalg.slogdet(unit)[1] + 2 * np.sum(np.log(scale)) - np.linalg.slogdet(prior.T @ prior)[1]
        scores.append(cost + freedom)
    return float(_ROUGHNESSES[int(np.argmin(scores))])
