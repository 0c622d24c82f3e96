"""Dipoles along a survey line: found in windows that overlap, added and removed as the evidence for them says."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.localization.line_data import LineData
from tam_calibration.localization.line_path import Path
from tam_calibration.localization.line_window import OF_SOURCE, Window
from tam_calibration.localization.window_dipoles import (
    LEAST_GAIN,
    UNEXPLAINED,
    add_dipole,
    evidence_of,
    fit_from,
    mean_square,
    remove_weak,
)
from tam_calibration.localization.window_fit import Solved, likeliest_roughness, solve
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray

_STEP_M, _HALF_M = 25.0, 30.0
"""Way from window to window, and half of a window's length, metres: targets are seen within three times their depth."""

_OWN_M, _SEEN_M = 25.0, 45.0
"""Way from a window's middle within which dipoles are found in it, and within which they are fitted again, metres. The
second fit is not kept. A drift of the navigation has moved those dipoles too: taken as exact, they would tie the path
of the window to their errors."""

_TOGETHER_M = 10.0
"""Way within which dipoles are taken from one window, metres."""

_MOST_LEFT = 2.0
"""Median of the residuals along a line, over the noise, above which it is refused."""

_CLEAR, _ROUNDS = 1.05, 2
"""Mean squared residual, over the noise, below which all dipoles of a window have been found; and how often others are
fitted anew, with what their neighbours have found since."""

_LAST_STEPS = 100
"""Most steps of the fit that an answer comes from."""


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
    sources: FloatArray = np.zeros((0, OF_SOURCE))
    for middle in line.middles():
        sources, _ = line.fit_window(middle, sources)
    ratio = float(np.median(line.left))
    if ratio > _MOST_LEFT:  # of most moments: what is wrong there is not at single places
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
        if not len(sources):
            return np.zeros(0), np.zeros(0)
        distance = norm(self._places[:, None] - sources[:, :3], axis=2)
        return self._data.along_m[np.argmin(distance, axis=0)], distance.min(axis=0)

    def fit_window(self, middle: float, sources: FloatArray, clear: float = 0.0) -> tuple[FloatArray, Solved]:
        """Return the dipoles (S, 6) of the line with those of a window fitted anew, and the window's solution.

        Dipoles are added where the mean squared residual, over the noise, exceeds ``clear``. Where a fit fails that
        succeeded before, they stay as they were.
        """
        at = np.flatnonzero(np.abs(self._data.along_m - middle) <= _HALF_M)
        away = np.abs(self._way(sources)[0] - middle)
        own, neighbours = sources[away <= _OWN_M], sources[(away > _OWN_M) & (away <= _SEEN_M)]
        window = Window(self._data.take(at), self._path, sources[away > _SEEN_M], self._roughness, neighbours)
        solved = fit_from(window, np.concatenate([neighbours.ravel(), own.ravel(), window.start()]))
        while mean_square(solved) > clear and (more := add_dipole(solved, len(neighbours))):
            solved = more
        solved = remove_weak(solved, len(neighbours))
        near = np.abs(window.data.along_m - middle) <= _STEP_M
        left = np.sqrt(np.mean(solved.residual[near] ** 2, axis=1))
        if np.mean(left**2) > max(UNEXPLAINED, self.misfit(middle)):
            return sources, solved
        self.left[at[near]] = left
        return np.concatenate([sources[away > _OWN_M], solved.sources[len(neighbours) :]]), solved

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
        solved = solve(rough.window, rough.unknowns, _LAST_STEPS)
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
    if inside[-1] - inside[0] <= _TOGETHER_M:
        return [_Section(float(inside[0] + inside[-1]) / 2, first, last)]
    widest = int(np.argmax(np.diff(inside)))
    middle = float(inside[widest] + inside[widest + 1]) / 2
    return _divided(ways, first, middle) + _divided(ways, middle, last)


def _cost(solved: Solved) -> float:
    """Return χ² with what each dipole must explain."""
    return solved.chi_square + LEAST_GAIN * len(solved.sources)
