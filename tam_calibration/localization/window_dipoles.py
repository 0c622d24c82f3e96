"""Dipoles of one window of a line: one more where the evidence for it is enough, one less where it is not."""

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import scaled
from tam_calibration.localization.line_window import Window
from tam_calibration.localization.window_fit import ROUGH_FALL, ROUGH_STEPS, Solved, annealed, solve
from tam_calibration.model.units import FloatArray

UNEXPLAINED = 1.3
"""Mean squared residual, over the noise, above which a fit has failed, or neighbours led it astray."""

LEAST_GAIN = 45.0
"""Fall of χ² from which a dipole is there: six unknowns and the places of a line's ten thousand cells make 45 with a
probability of 5e-4 (χ² of six degrees of freedom, times the cells)."""

_TRIED_GAIN = 30.0
"""Fall of χ², to first order, from which a place is tried."""

_MOST_TRIED, _MOST_TRIED_BESIDE_MUCH, _MOST_SOURCES = 2, 6, 10
"""Places that are tried one after the other, the same where residuals are large, and dipoles of a window."""

_ONE = 0.3
"""Distance between two dipoles, over that from the path, below which they may be one that was found in steps."""

_GLANCE_STEPS = 6
"""Steps after which a place that explains less than half of what is needed is given up."""

_LARGEST_LEFT = 2.0
"""Mean squared residual, over the noise, above which something large is still missing."""

_NEAREST_M, FARTHEST_M = 0.5, 20.0
"""Distances from the path between which dipoles are looked for: a window is three times the farthest long."""

_SPACING_M, _DISTANCES_M, _ANGLES = 2.0, (2.0, 3.0, 4.5, 6.5, 9.5, 14.0), 8
"""Places that are looked at: way between them, distances from the path, and directions across it."""

_THIN_M = 1.0
"""Way between the moments at which they are looked at, metres."""


def fit_from(window: Window, start: FloatArray) -> Solved:
    """Return the solution that begins with known dipoles, also with a larger noise where that explains more."""
    plain = solve(window, start, ROUGH_STEPS, ROUGH_FALL)
    if mean_square(plain) < UNEXPLAINED:
        return solve(window, plain.unknowns, least_fall=ROUGH_FALL)
    return min(plain, annealed(window, start), key=lambda each: each.chi_square)


def evidence_of(solved: Solved) -> FloatArray:
    """Return by how much χ² would rise (S,) without each dipole, to first order in its moment.

    Its place counts as known: without a moment, no other place makes up for it.
    """
    unit, scale = scaled(solved.covariances)
    size = solved.sources[:, 3:] / scale[:, 3:]
    return np.asarray(np.einsum("si,sij,sj->s", size, np.linalg.pinv(unit, hermitian=True)[:, 3:, 3:], size))


def mean_square(solved: Solved) -> float:
    """Return the mean squared residual, at least one."""
    return max(1.0, float(np.mean(solved.residual**2)))


def add_dipole(solved: Solved, first: int) -> Solved | None:
    """Return the solution with one more dipole, if there is evidence for it and those from a first on are in sight."""
    if len(solved.sources) - first >= _MOST_SOURCES:
        return None
    gains, places, moments = _gains(solved)
    has_much_left = mean_square(solved) > _LARGEST_LEFT
    for _ in range(_MOST_TRIED_BESIDE_MUCH if has_much_left else _MOST_TRIED):
        best = int(np.argmax(gains))
        if gains[best] < _TRIED_GAIN * min(mean_square(solved), _LARGEST_LEFT):
            return None
        start = np.concatenate([solved.sources.ravel(), places[best], moments[best], solved.others])
        gains[norm(places - places[best], axis=1) < _THIN_M * 4] = 0.0
        if not has_much_left:
            glance = solve(solved.window, start, _GLANCE_STEPS, ROUGH_FALL)
            if solved.chi_square - glance.chi_square < LEAST_GAIN / 2:
                continue
            start = glance.unknowns
        more = annealed(solved.window, start) if has_much_left else solve(solved.window, start, least_fall=ROUGH_FALL)
        if solved.chi_square - more.chi_square > LEAST_GAIN * mean_square(more) and _is_sound(more, first):
            return more
    return None


def _is_sound(solved: Solved, first: int) -> bool:
    """Return whether dipoles from a first are in sight."""
    distance = norm(solved.sources[first:, None, :3] - solved.window.place_m, axis=2).min(axis=1)
    return bool(((distance > _NEAREST_M) & (distance < FARTHEST_M)).all())


def remove_weak(solved: Solved, first: int) -> Solved:
    """Return the solution without those dipoles, from a first on, that hardly lower χ²."""
    while True:
        fits = [fit_from(solved.window, start) for start in _starts_with_fewer(solved, first)]
        fewer = min(fits, key=lambda each: each.chi_square, default=None)
        most = LEAST_GAIN * min(mean_square(solved), _LARGEST_LEFT)
        if fewer is None or fewer.chi_square - solved.chi_square > most:
            return solved
        solved = fewer


def _starts_with_fewer(solved: Solved, first: int) -> Iterator[FloatArray]:
    """Yield unknowns without the weakest dipole, if it is weak, and with the two nearest to each other as one."""
    sources, own = solved.sources, solved.sources[first:]
    if not len(own):
        return
    worth = evidence_of(solved)[first:]
    weakest = first + int(np.argmin(worth))
    if worth.min() <= LEAST_GAIN * min(mean_square(solved), _LARGEST_LEFT):
        yield np.concatenate([np.delete(sources, weakest, axis=0).ravel(), solved.others])
    apart = norm(own[:, None, :3] - own[:, :3], axis=2) + np.diag(np.full(len(own), np.inf))
    one, other = (first + int(number) for number in np.unravel_index(np.argmin(apart), apart.shape))
    distance = norm(solved.window.place_m - sources[one, :3], axis=1).min()
    if apart.min() < _ONE * distance:
        together = sources.copy()
        together[one, 3:] += sources[other, 3:]
        yield np.concatenate([np.delete(together, other, axis=0).ravel(), solved.others])


def _gains(solved: Solved) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the fall of χ² (n,) by a further dipole at places (n, 3), and its moment (n, 3), to first order."""
    window = solved.window
    thin, places, columns = _looked_at(window)
    residual, slopes = thin.linearized(solved.unknowns)
    rows = slopes.reshape(-1, slopes.shape[2])
    count = solved.sources.size
    precision = np.zeros((rows.shape[1],) * 2)
    precision[count:, count:] = thin.precision
    normal = rows.T @ rows + precision + 1e-12 * np.diag(np.diag(rows.T @ rows))
    unit, scale = scaled(normal)
    root = np.linalg.cholesky(unit + 1e-12 * np.eye(len(normal)))
    basis = np.linalg.solve(root, (rows / scale).T)
    left = residual.ravel() - basis.T @ (basis @ residual.ravel())
    seen = (basis @ columns).reshape(len(basis), -1, 3)
    cube = columns.reshape(len(rows), -1, 3)
    every, taken = (np.einsum("rpi,rpj->pij", each, each, optimize=True) for each in (cube, seen))
    information = every - taken
    slope = (columns.T @ left).reshape(-1, 3)
    size = np.trace(information, axis1=1, axis2=2)[:, None, None]
    moments = np.linalg.solve(information + 1e-6 * size * np.eye(3), slope[..., None])[..., 0]
    return np.sum(moments * slope, axis=1), places, moments


@lru_cache(maxsize=1)
def _looked_at(window: Window) -> tuple[Window, FloatArray, FloatArray]:
    """Return some moments of a window, places (n, 3), and the data's derivatives (R, 3 n) by moments there."""
    way = window.data.along_m
    order = np.argsort(way)
    picked = order[np.unique(np.searchsorted(way[order], np.arange(way.min(), way.max(), _THIN_M)))]
    at = np.unique(np.concatenate([[0], picked[picked < len(way)], [len(way) - 1]]))
    thin = replace(window, data=window.data.take(at))
    places = _places(thin)
    return thin, places, thin.by_moment(places).reshape(-1, 3 * len(places))


def _places(window: Window) -> FloatArray:
    """Return places (n, 3) around the path of a window."""
    way = window.data.along_m
    path = window.place_m
    marks = np.arange(way.min() + _SPACING_M, way.max() - _SPACING_M / 2, _SPACING_M)
    at = np.array([np.argmin(np.abs(way - mark)) for mark in marks]) if len(marks) else np.array([len(way) // 2])
    ahead = path[np.minimum(at + 2, len(path) - 1)] - path[np.maximum(at - 2, 0)]
    ahead /= np.maximum(norm(ahead, axis=1, keepdims=True), 1e-9)
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side /= np.maximum(norm(side, axis=1, keepdims=True), 1e-9)
    up = np.cross(side, ahead)
    angle = 2 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    across = np.cos(angle)[:, None, None] * side + np.sin(angle)[:, None, None] * up
    distances = np.array(_DISTANCES_M)[:, None, None, None]
    return np.asarray((path[at] + distances * across).reshape(-1, 3))
