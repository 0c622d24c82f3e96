"""Dipoles along a survey line: found in windows that overlap, added and removed as the evidence for them says."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.linalg import norm

from tam_calibration.localization.line_data import LineData
from tam_calibration.localization.line_path import Path
from tam_calibration.localization.line_window import OF_SOURCE, Window
from tam_calibration.localization.window_fit import ROUGH_FALL, Solved, annealed, solve
from tam_calibration.model.units import FloatArray

_STEP_M, _HALF_M = 25.0, 30.0
"""Way from window to window, and half of a window's length, metres: targets are seen within three times their depth."""

_OWN_M, _SEEN_M = 25.0, 45.0
"""Way from a window's middle within which dipoles are found in it, and within which they are fitted again, metres. The
second fit is not kept. A drift of the navigation has moved those dipoles too: taken as exact, they would tie the path
of the window to their errors."""

_TOGETHER_M = 10.0
"""Way within which dipoles are told by one window, metres."""

LEAST_GAIN = 45.0
"""Fall of χ² from which a dipole is there: six unknowns and the places of a line's ten thousand cells make 45 with a
probability of 5e-4 (χ² of six degrees of freedom, times the cells)."""

_TRIED_GAIN = 30.0
"""Fall of χ², to first order, from which a place is tried."""

_CLEAR = 1.05
"""Mean squared residual, over the noise, below which all dipoles of a window have been found."""

_UNEXPLAINED = 1.3
"""Mean squared residual, over the noise, above which a window is begun again: its neighbours are known by then."""

_MOST_TRIED, _MOST_TRIED_BESIDE_MUCH, _MOST_SOURCES = 2, 6, 10
"""Places that are tried one after the other, also beside large residuals, and dipoles of a window."""

_GLANCE_STEPS = 6
"""Steps after which a place that explains less than half of what is needed is given up."""

LARGEST_LEFT = 2.0
"""Mean squared residual, over the noise, above which something large is still missing."""

_SPACING_M, _DISTANCES_M, _ANGLES = 2.0, (2.0, 3.0, 4.5, 6.5, 9.5, 14.0), 8
"""Places that are looked at: way between them, distances from the path, and directions across it."""

_THIN_M = 1.0
"""Way between the moments at which they are looked at, metres."""


@dataclass(frozen=True, eq=False)
class Found:
    """A dipole, and the window that tells most of it.

    Parameters
    ----------
    unknowns : (6,) array
        Place in metres and moment in A m².
    covariance : (6, 6) array
        Of both, for the stated noise.
    misfit : float
        Mean squared residual about it, in units of the noise.
    gain : float
        Fall of χ² by it, to first order.
    distance_m : float
        From the path.
    """

    unknowns: FloatArray
    covariance: FloatArray
    misfit: float
    gain: float
    distance_m: float


def search(data: LineData, path: Path) -> tuple[list[Found], FloatArray]:
    """Return the dipoles that a line shows, and the root mean square of what they leave at each moment (M,).

    Parameters
    ----------
    data : LineData
        Of the whole line.
    path : Path
        Of the array's centre.
    """
    line = _Line(data, path)
    sources: FloatArray = np.zeros((0, OF_SOURCE))
    for middle in line.middles():
        sources, _ = line.explained(middle, sources)
    for middle in line.middles():
        if line.misfit(middle) > _UNEXPLAINED:
            sources = line.begun_again(middle, sources)
    found: list[Found] = []
    for middle in line.groups(sources):
        sources, solved = line.explained(middle, sources, is_last=True)
        found += line.told(middle, solved)
    return found, line.left


class _Line:
    """The whole line, and its windows."""

    def __init__(self, data: LineData, path: Path) -> None:
        self._data, self._path = data, path
        self._places = path.at(data.time_s)
        self.left = np.zeros(len(data.time_s))

    def middles(self) -> list[float]:
        """Return the ways along the line at which windows have their middle, those of the strongest signal first.

        A strong dipole at the edge of a window, where it is not found, would lead astray those that are.
        """
        way, fields = self._data.along_m, self._data.fields_T
        apart = fields - fields.mean(axis=1, keepdims=True)
        signal = norm(apart - np.median(apart, axis=0), axis=(1, 2))
        count = max(1, round((way[-1] - way[0]) / _STEP_M))
        edges = np.linspace(way[0], way[-1], count + 1)
        middles = (edges[:-1] + edges[1:]) / 2
        strongest = [signal[np.abs(way - middle) <= _STEP_M].max(initial=0.0) for middle in middles]
        return [float(middles[number]) for number in np.argsort(strongest)[::-1]]

    def groups(self, sources: FloatArray) -> list[float]:
        """Return the middles of windows about dipoles (S, 6) that lie close together along the line."""
        middles: list[list[float]] = []
        for way in sorted(self._way(sources)[0].tolist()):
            if middles and way - middles[-1][0] < _TOGETHER_M:
                middles[-1].append(way)
            else:
                middles.append([way])
        return [(ways[0] + ways[-1]) / 2 for ways in middles]

    def _way(self, sources: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the way (S,) along the line at which each dipole is passed, and its distance."""
        if not len(sources):
            return np.zeros(0), np.zeros(0)
        distance = norm(self._places[:, None] - sources[:, :3], axis=2)
        return self._data.along_m[np.argmin(distance, axis=0)], distance.min(axis=0)

    def explained(self, middle: float, sources: FloatArray, is_last: bool = False) -> tuple[FloatArray, Solved]:
        """Return the dipoles (S, 6) of the line with those of a window fitted anew, and the window's solution."""
        at = np.flatnonzero(np.abs(self._data.along_m - middle) <= _HALF_M)
        away = np.abs(self._way(sources)[0] - middle)
        own, beside = sources[away <= _OWN_M], sources[(away > _OWN_M) & (away <= _SEEN_M)]
        window = Window(self._data.take(at), self._path, sources[away > _SEEN_M])
        solved = annealed(window, np.concatenate([beside.ravel(), own.ravel(), window.start()]))
        may_add = not is_last or _reduced(solved) > _CLEAR
        while may_add and len(solved.sources) - len(beside) < _MOST_SOURCES:
            more = _with_another(solved, len(beside))
            if more is None:
                break
            solved = more
        solved = _without_needless(solved, len(beside))
        if is_last:
            solved = solve(window, solved.unknowns)
        near = np.abs(window.data.along_m - middle) <= _STEP_M
        self.left[at[near]] = np.sqrt(np.mean(solved.residual[near] ** 2, axis=1))
        return np.concatenate([sources[away > _OWN_M], solved.sources[len(beside) :]]), solved

    def misfit(self, middle: float) -> float:
        """Return the mean squared residual about a middle, over the noise."""
        return float(np.mean(self.left[np.abs(self._data.along_m - middle) <= _STEP_M] ** 2))

    def begun_again(self, middle: float, sources: FloatArray) -> FloatArray:
        """Return the dipoles (S, 6) with those of a window found anew from none, where these explain more."""
        before, left = self.misfit(middle), self.left.copy()
        is_own = np.abs(self._way(sources)[0] - middle) <= _OWN_M
        found, _ = self.explained(middle, sources[~is_own])
        if self.misfit(middle) < before:
            return found
        self.left = left
        return sources

    def told(self, middle: float, solved: Solved) -> Iterator[Found]:
        """Yield the dipoles that a window is about."""
        covariance, data = solved.covariance, solved.window.data
        ways, distances = self._way(solved.sources)
        worth = _worth(solved)
        for number, (source, way, distance) in enumerate(zip(solved.sources, ways, distances, strict=True)):
            if abs(way - middle) > _TOGETHER_M / 2:
                continue
            own = slice(OF_SOURCE * number, OF_SOURCE * (number + 1))
            near = np.abs(data.along_m - way) <= max(4.0, 1.5 * distance)
            misfit = float(np.mean(solved.residual[near] ** 2))
            yield Found(source, covariance[own, own], misfit, worth[number], float(distance))


def _worth(solved: Solved) -> FloatArray:
    """Return by how much χ² would rise (S,) without each dipole, to first order."""
    worth = []
    for number, source in enumerate(solved.sources):
        own = slice(OF_SOURCE * number + 3, OF_SOURCE * (number + 1))
        worth.append(float(source[3:] @ np.linalg.lstsq(solved.covariance[own, own], source[3:], rcond=None)[0]))
    return np.array(worth)


def _reduced(solved: Solved) -> float:
    """Return the mean squared residual, at least one."""
    return max(1.0, float(np.mean(solved.residual**2)))


def _with_another(solved: Solved, first: int) -> Solved | None:
    """Return the solution with one more dipole, where the evidence for it is enough and those from a first are near."""
    gains, places, moments = _gains(solved)
    for _ in range(_MOST_TRIED if _reduced(solved) < LARGEST_LEFT else _MOST_TRIED_BESIDE_MUCH):
        best = int(np.argmax(gains))
        if gains[best] < _TRIED_GAIN * min(_reduced(solved), LARGEST_LEFT):
            return None
        start = np.concatenate([solved.sources.ravel(), places[best], moments[best], solved.others])
        if _reduced(solved) < LARGEST_LEFT:
            glance = solve(solved.window, start, _GLANCE_STEPS, ROUGH_FALL)
            if solved.chi_square - glance.chi_square < LEAST_GAIN / 2:
                gains[norm(places - places[best], axis=1) < _THIN_M * 4] = 0.0
                continue
            start = glance.unknowns
        for fit in (annealed, solve):
            more = fit(solved.window, start, least_fall=ROUGH_FALL)
            if solved.chi_square - more.chi_square > LEAST_GAIN * _reduced(more) and _is_sound(more, first):
                return more
            if _reduced(solved) < LARGEST_LEFT:
                break
        gains[norm(places - places[best], axis=1) < _THIN_M * 4] = 0.0
    return None


def _is_sound(solved: Solved, first: int) -> bool:
    """Return whether dipoles from a first are in sight: from half a metre to half a window off the path."""
    distance = norm(solved.sources[first:, None, :3] - solved.window.path.at(solved.window.data.time_s), axis=2).min(
        axis=1
    )
    return bool(((distance > 0.5) & (distance < _HALF_M)).all())


def _without_needless(solved: Solved, first: int) -> Solved:
    """Return the solution without dipoles, from the first on, that χ² hardly rises without."""
    while len(solved.sources) > first:
        worth = _worth(solved)
        weakest = first + int(np.argmin(worth[first:]))
        if worth[weakest] > LEAST_GAIN * _reduced(solved):
            break
        rest = np.delete(solved.sources, weakest, axis=0)
        fewer = annealed(solved.window, np.concatenate([rest.ravel(), solved.others]))
        if fewer.chi_square - solved.chi_square > LEAST_GAIN * _reduced(solved):
            break
        solved = fewer
    return solved


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
    scale = np.sqrt(np.diag(normal))
    root = np.linalg.cholesky(normal / scale[:, None] / scale + 1e-12 * np.eye(len(normal)))
    basis = np.linalg.solve(root, (rows / scale).T)
    left = residual.ravel() - basis.T @ (basis @ residual.ravel())
    seen = (basis @ columns).reshape(len(basis), -1, 3)
    cube = columns.reshape(len(rows), -1, 3)
    information = np.einsum("rpi,rpj->pij", cube, cube, optimize=True) - np.einsum(
        "rpi,rpj->pij", seen, seen, optimize=True
    )
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
    thin = Window(window.data.take(at), window.path, window.fixed)
    places = _places(thin)
    return thin, places, thin.by_moment(places).reshape(-1, 3 * len(places))


def _places(window: Window) -> FloatArray:
    """Return places (n, 3) around the path of a window."""
    way = window.data.along_m
    path = window.path.at(window.data.time_s)
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
