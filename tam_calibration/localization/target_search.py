"""Dipoles along a survey line: found in windows that overlap, added and removed as the evidence for them says."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import scaled
from tam_calibration.fit.contradiction import TOO_FAR
from tam_calibration.localization.line_data import LineData
from tam_calibration.localization.line_path import Path
from tam_calibration.localization.line_window import Window
from tam_calibration.localization.window_fit import (
    ROUGH_FALL,
    ROUGH_STEPS,
    UNCOVERED,
    Solved,
    annealed,
    likeliest_roughness,
    solve,
)
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray

UNEXPLAINED = 1.3
"""Mean squared residual, over the noise, above which a fit has failed, or neighbours led it astray."""

LEAST_GAIN = 45.0
"""Fall of χ² from which a dipole is there: six unknowns and the places of a line's ten thousand cells make 45 with a
probability of 5e-4 (χ² of six degrees of freedom, times the cells)."""

_MOST_TRIED, _MOST_TRIED_BESIDE_MUCH, _MOST_SOURCES = 2, 6, 10
"""Places that are tried one after the other, the same where residuals are large, and dipoles of a window."""

_ONE = 0.3
"""Distance between two dipoles, over that from the path, below which they may be one that was found in steps."""

_NEAREST_M, FARTHEST_M = 0.5, 20.0
"""Distances from the path between which dipoles are looked for: a window is three times the farthest long."""

_SPACING_M, _DISTANCES_M, _ANGLES = 2.0, (2.0, 3.0, 4.5, 6.5, 9.5, 14.0), 8
"""Places that are looked at, at moments half as far apart: way between them, distances from the path, and directions
across it."""


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
    has_much_left = mean_square(solved) > UNCOVERED
    for _ in range(_MOST_TRIED_BESIDE_MUCH if has_much_left else _MOST_TRIED):
        best = int(np.argmax(gains))
        if gains[best] < LEAST_GAIN / 2 * min(mean_square(solved), UNCOVERED):
            return None
        start = np.concatenate([solved.sources.ravel(), places[best], moments[best], solved.others])
        gains[norm(places - places[best], axis=1) < 2 * _SPACING_M] = 0.0
        if not has_much_left:
            glance = solve(solved.window, start, ROUGH_STEPS, ROUGH_FALL)
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
        most = LEAST_GAIN * min(mean_square(solved), UNCOVERED)
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
    if worth.min() <= LEAST_GAIN * min(mean_square(solved), UNCOVERED):
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
    picked = order[np.unique(np.searchsorted(way[order], np.arange(way.min(), way.max(), _SPACING_M / 2)))]
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


_STEP_M, _HALF_M = 25.0, 30.0
"""Way from window to window, within which dipoles are found in one, and half of its length, metres: targets are seen
within three times their depth."""

_CLEAR, _ROUNDS = 1.05, 2
"""Mean squared residual, over the noise, below which all dipoles of a window have been found; and how often others are
fitted anew, with what their neighbours have found since."""


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

    Raises
    ------
    Refused
        When dipoles do not explain the line.
    """
    line = _Line(data, path)
    sources: FloatArray = np.zeros((0, 6))
    for middle in line.middles():
        sources, _ = line.fit_window(middle, sources)
    ratio = float(np.median(line.left))
    if ratio > TOO_FAR:  # of most moments: what is wrong there is not at single places
        raise Refused(
            f"the readings are not those of dipoles: what is left along the line is {ratio:.3g} times the noise. "
            "Calibrate the array anew, by --method integrated if its sensors may have turned; or state errors of the "
            "velocity, the positions or the attitude"
        )
    sources = line.choose_roughness(sources)
    for section in line.sections(sources):
        sources = line.restart(section, sources)
    for _round in range(_ROUNDS):
        for section in line.sections(sources):
            if line.misfit(section.middle) > _CLEAR:
                sources, _ = line.fit_window(section.middle, sources, _CLEAR)
    found: list[Found] = []
    for section in line.sections(sources):
        _, solved = line.fit_window(section.middle, sources, np.inf)
        found += line.dipoles_in(section, solved)
    return found, line.left


@dataclass(frozen=True)
class _Section:
    """A part of a line: from where to where dipoles in it are passed, and the middle of its window, metres of way."""

    middle: float
    first: float
    last: float


class _Line:
    """The whole line, and its windows."""

    def __init__(self, data: LineData, path: Path) -> None:
        self._data, self._path = data, path
        self._places = path.at(data.time_s)
        self._roughness = 1.0
        self.left = np.full(len(data.time_s), np.inf)

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

    def sections(self, sources: FloatArray) -> list[_Section]:
        """Return sections about dipoles (S, 6) that lie close together along the line, divided at the widest gaps."""
        ways = np.sort(self._way(sources)[0])
        return _divided(ways, -np.inf, np.inf) if len(ways) else []

    def _way(self, sources: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the way (S,) along the line at which each dipole is passed, and its distance."""
        distance = norm(self._places[:, None] - sources[:, :3], axis=2)
        return self._data.along_m[np.argmin(distance, axis=0)], distance.min(axis=0)

    def fit_window(self, middle: float, sources: FloatArray, clear: float = 0.0) -> tuple[FloatArray, Solved]:
        """Return the dipoles (S, 6) of the line with those of a window fitted anew, and the window's solution.

        Dipoles are added where the mean squared residual, over the noise, exceeds ``clear``. Where a fit fails that
        succeeded before, they stay as they were.
        """
        at = np.flatnonzero(np.abs(self._data.along_m - middle) <= _HALF_M)
        away = np.abs(self._way(sources)[0] - middle)
        # Dipoles further on are fitted again, and that fit is not kept. A drift of the navigation has moved them too:
        # taken as exact, they would tie the path of the window to their errors.
        is_own, is_far = away <= _STEP_M, away > _STEP_M + FARTHEST_M
        own, neighbours = sources[is_own], sources[~is_own & ~is_far]
        window = Window(self._data.take(at), self._path, sources[is_far], self._roughness, neighbours)
        solved = fit_from(window, np.concatenate([neighbours.ravel(), own.ravel(), window.start()]))
        while mean_square(solved) > clear and (more := add_dipole(solved, len(neighbours))):
            solved = more
        solved = remove_weak(solved, len(neighbours))
        near = np.abs(window.data.along_m - middle) <= _STEP_M
        left = np.sqrt(np.mean(solved.residual[near] ** 2, axis=1))
        if np.mean(left**2) > max(UNEXPLAINED, self.misfit(middle)):
            return sources, solved
        self.left[at[near]] = left
        return np.concatenate([sources[~is_own], solved.sources[len(neighbours) :]]), solved

    def misfit(self, middle: float) -> float:
        """Return the mean squared residual about a middle, over the noise."""
        return float(np.mean(self.left[np.abs(self._data.along_m - middle) <= _STEP_M] ** 2))

    def restart(self, section: _Section, sources: FloatArray) -> FloatArray:
        """Return the dipoles (S, 6) with those of a section found anew from none, where that is likelier.

        What was found in it first may stand for what was not known yet, or several dipoles for one.
        """
        sources, solved = self.fit_window(section.middle, sources, _CLEAR)
        way, left = self._way(sources)[0], self.left.copy()
        is_own = (way > section.first) & (way <= section.last)
        if is_own.sum() < 2 and mean_square(solved) < _CLEAR:
            return sources
        others = sources[~is_own]
        found, anew = self.fit_window(section.middle, others)
        if found is not others and _cost(anew) < _cost(solved):
            return found
        self.left = left
        return sources

    def choose_roughness(self, sources: FloatArray) -> FloatArray:
        """Take the regional field as smooth as most windows show it, and return the dipoles (S, 6) of the line.

        Not as all: dipoles that were not found yet bend it in some.
        """
        best = []
        for middle in self.middles():
            sources, solved = self.fit_window(middle, sources, np.inf)
            best.append(likeliest_roughness(solved))
        self._roughness = float(np.median(best))
        return sources

    def dipoles_in(self, section: _Section, rough: Solved) -> Iterator[Found]:
        """Yield the dipoles of a window that are passed in a section of the line."""
        solved = solve(rough.window, rough.unknowns)
        data = solved.window.data
        every = zip(solved.sources, solved.covariances, evidence_of(solved), *self._way(solved.sources), strict=True)
        for source, covariance, gain, way, distance in every:
            if section.first < way <= section.last:
                near = np.abs(data.along_m - way) <= max(4.0, 1.5 * distance)
                misfit = float(np.mean(solved.residual[near] ** 2))
                yield Found(source, covariance, misfit, float(gain), float(distance))


def _divided(ways: FloatArray, first: float, last: float) -> list[_Section]:
    """Return sections about sorted ways (S,), each of little span, which end in the middle of the widest gaps."""
    inside = ways[(ways > first) & (ways <= last)]
    if inside[-1] - inside[0] <= FARTHEST_M / 2:
        return [_Section(float(inside[0] + inside[-1]) / 2, first, last)]
    widest = int(np.argmax(np.diff(inside)))
    middle = float(inside[widest] + inside[widest + 1]) / 2
    return _divided(ways, first, middle) + _divided(ways, middle, last)


def _cost(solved: Solved) -> float:
    """Return χ² with what each dipole must explain."""
    return solved.chi_square + LEAST_GAIN * len(solved.sources)
