"""An effect that is on in some windows of time and off in between, found from its signal while on."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.motion import sum_around
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.fitted_effect import Shape
from tam_calibration.model.units import FloatArray

_MOST_WINDOWS = 300
"""Windows at most."""

WINDOW_UNITS = {f"{edge}_{number}_s": "s" for number in range(1, _MOST_WINDOWS + 1) for edge in ("on", "off")}
"""SI units of the times of windows in a shape; the last window may have no end."""

_SETTLED = 3
"""Levels whose states are refined: those of which two rough states explain most."""

_ROUNDS = 6
_SPANS = (4, 16, 64)
"""Samples on either side from which a slowly varying level is predicted."""


@dataclass(frozen=True, eq=False)
class Switching:
    """Two states of a level.

    Parameters
    ----------
    is_on : (N,) array of bool
        Whether the second state is present.
    gain : float
        Energy that the two levels explain beyond one.
    scale : float
        Residual energy per residual.
    """

    is_on: NDArray[np.bool_]
    gain: float
    scale: float

    @property
    def flips(self) -> NDArray[np.intp]:
        """Samples at which the state changes."""
        return np.flatnonzero(np.diff(self.is_on)) + 1

    @property
    def windows(self) -> list[tuple[int, int]]:
        """First sample of each window in the rarer state, and first one after it (N at the end)."""
        is_in = self.is_on if self.is_on.mean() <= 0.5 else ~self.is_on
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_in, [False]])))
        return list(zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True))

    def shape(self, covariates: Covariates) -> Shape:
        """Return the times of the windows."""
        time = covariates.time_s
        before = np.concatenate([time[:1] - covariates.step_s / 2, (time[1:] + time[:-1]) / 2])
        shape = {}
        for number, (on, off) in enumerate(self.windows, start=1):
            shape[f"on_{number}_s"] = float(before[on])
            if off < len(time):
                shape[f"off_{number}_s"] = float(before[off])
        return shape


def in_windows(covariates: Covariates, shape: Shape) -> NDArray[np.bool_]:
    """Return whether each sample (N,) is in a window of a shape.

    Parameters
    ----------
    covariates : Covariates
        Times of the N samples.
    shape : Shape
        ``on_1_s``, ``off_1_s``, ``on_2_s``, ...: limits of the windows, seconds; a last one without ``off`` has no end.
    """
    is_in = np.zeros(covariates.sample_count, dtype=bool)
    for number in range(1, _MOST_WINDOWS + 1):
        if f"on_{number}_s" not in shape:
            break
        end = shape.get(f"off_{number}_s", np.inf)
        is_in |= (covariates.time_s >= shape[f"on_{number}_s"]) & (covariates.time_s < end)
    return is_in


def windows_of(shape: Shape) -> Shape:
    """Return the limits of windows in the shape of any effect; a step begins one.

    Parameters
    ----------
    shape : Shape
        With ``on_1_s``, ``off_1_s``, ... or ``time_s`` and ``end_s``; without them there are no windows.
    """
    step = {"on_1_s": "time_s", "off_1_s": "end_s"} if "time_s" in shape else dict.fromkeys(WINDOW_UNITS)
    return {name: shape[own or name] for name, own in step.items() if (own or name) in shape}


@dataclass(frozen=True, eq=False)
class Level:
    """Residuals of a row modelled as a given function times a level that may change.

    Parameters
    ----------
    shift, function, information : (N,) array
        Residuals, their derivative by the level, and their inverse variances; 0 in samples that do not count.
    held : (N, Q) array
        Nuisance functions, which span the function too.
    """

    shift: FloatArray
    function: FloatArray
    information: FloatArray
    held: FloatArray

    @classmethod
    def of_row(cls, residuals: WhitenedResiduals, row: int, function: FloatArray) -> "Level":
        """Return the level of a function (N,) in a row, beside the row's calibration.

        Parameters
        ----------
        residuals : WhitenedResiduals
            Of N samples.
        row : int
            Index of the row.
        function : (N,) array
            Function that the level multiplies, tesla per unit of the level.
        """
        direction = residuals.covariates.field_T / residuals.covariates.intensity_T[:, None]
        information = np.where(residuals.is_counted, residuals.row_information[:, row], 0.0)
        held = np.column_stack([np.ones(len(function)), direction])
        return cls(residuals.row_shift_T[:, row], function, information, held)

    def start(self) -> Switching:
        """Return states by a threshold of the local level, the one that separates them best."""
        product, square = self._sums()
        local = _ratio(sum_around(product, _SPANS[1]), sum_around(square, _SPANS[1]))
        order = np.argsort(local)
        score, size = np.cumsum(product[order]), np.cumsum(square[order])
        free = score - size * (score[-1] / size[-1])
        left = np.maximum(size * (1 - size / size[-1]), np.finfo(float).tiny)
        best = int(np.argmax(free[:-1] ** 2 / left[:-1]))
        return self.of(local > local[order[best]])

    def settled(self, start: Switching) -> Switching:
        """Return the states that explain most less a penalty per change, alternating with the fit of their levels."""
        best = start
        for _ in range(_ROUNDS):
            level, rest = self._fit(self.function * best.is_on)
            advantage = self.information * (rest**2 - (rest - level * self.function) ** 2)
            found = self.of(_segmented(advantage, 2 * best.scale * np.log(len(self.shift))))
            if np.array_equal(found.is_on, best.is_on):
                break
            best = found
        return best

    def is_switching(self, states: Switching) -> bool:
        """Whether states change to and fro, and explain more than a switching offset or a slowly varying level."""
        if not 1 < len(states.windows) <= _MOST_WINDOWS or states.gain < self.predicted():
            return False
        offset = replace(self, function=np.ones_like(self.function))
        return states.gain > offset.settled(offset.start()).gain

    def of(self, is_on: NDArray[np.bool_]) -> Switching:
        """Return the states with the energy that they explain."""
        count = max(int(np.count_nonzero(self.information)), 1)
        left = self._left(self.function * is_on)
        return Switching(is_on, self._without - left, left / count)

    def predicted(self) -> float:
        """Return the largest energy that a level explains which is predicted from neighbouring samples."""
        product, square = self._sums()
        levels = (_ratio(sum_around(product, span), sum_around(square, span)) for span in _SPANS)
        return self._without - min(self._left(level * self.function) for level in levels)

    def _sums(self) -> tuple[FloatArray, FloatArray]:
        """Return the score (N,) of a level in each sample, and its information."""
        weighted = self.information * self.function
        return weighted * self.shift, weighted * self.function

    def _fit(self, function: FloatArray) -> tuple[float, FloatArray]:
        """Return the level of a function (N,), beside the nuisance functions, and the residuals without these."""
        size = max(float(np.sqrt(np.mean(function**2))), np.finfo(float).tiny)
        design = np.column_stack([function / size, self.held])
        weighted = self.information[:, None] * design
        values = np.linalg.pinv(weighted.T @ design, hermitian=True) @ (weighted.T @ self.shift)
        return float(values[0]) / size, self.shift - self.held @ values[1:]

    @cached_property
    def _without(self) -> float:
        """Residual energy of one constant level."""
        return self._left(np.zeros_like(self.function))

    def _left(self, function: FloatArray) -> float:
        level, rest = self._fit(function)
        return float(self.information @ (rest - level * function) ** 2)


def settled_strongest(levels: Sequence[Level]) -> tuple[Switching, Level, int]:
    """Return the refined states that explain most, over several levels, with their level and its number."""
    started = [(level.start(), level, number) for number, level in enumerate(levels)]
    strongest = sorted(started, key=lambda one: -one[0].gain)[:_SETTLED]
    settled = [(level.settled(start), level, number) for start, level, number in strongest]
    return max(settled, key=lambda one: one[0].gain)


def _ratio(score: FloatArray, size: FloatArray) -> FloatArray:
    return np.asarray(score / np.maximum(size, np.finfo(float).eps * max(size.max(), np.finfo(float).tiny)))


def _segmented(advantage: FloatArray, price: float) -> NDArray[np.bool_]:
    """Return the states (N,) with the largest total advantage less a price for each change of state.

    Viterbi's recursion (Error bounds for convolutional codes, IEEE Trans. Inf. Theory 13, 1967, p. 260) for two states
    is one of their difference, which no change makes larger than the price.
    """
    lead, leads = 0.0, []
    for one in advantage.tolist():
        if lead > price:
            lead = price
        elif lead < -price:
            lead = -price
        lead += one
        leads.append(lead)
    is_on = np.empty(len(leads), dtype=bool)
    state = lead > 0
    for place in range(len(leads) - 1, -1, -1):
        state = leads[place] > (-price if state else price)
        is_on[place] = state
    return is_on
