"""Data of the figures of a gap: the recording, the same without its causes, and its simulated twin."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.gap.result import Gap
from tam_calibration.model.units import FloatArray
from tam_calibration.report.style import AFTER_COLOR, BEFORE_COLOR, QUIET_COLOR

_SHOWN_ROWS = 3


@dataclass(frozen=True, eq=False)
class State:
    """Residuals (N, 3K + 1) of one kind, tesla: its name, its colour, and their root mean squares over the floor."""

    name: str
    color: str
    rows_T: FloatArray
    ratio: FloatArray


@dataclass(frozen=True, eq=False)
class GapView:
    """A gap as its figures show it."""

    gap: Gap

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.gap.residue.floor_T) // 3

    @cached_property
    def states(self) -> tuple[State, ...]:
        """The recording, the recording without its causes where there are any, and the twin."""
        residue = self.gap.residue
        kinds = [("recording", BEFORE_COLOR, residue.before)]
        if self.gap.causes:
            kinds.append(("without its causes", AFTER_COLOR, residue.after))
        kinds.append(("simulated twin", QUIET_COLOR, residue.twin))
        return tuple(State(name, color, rows, self._ratio(rows)) for name, color, rows in kinds)

    def _ratio(self, rows_T: FloatArray) -> FloatArray:
        """Return the root mean squares of rows over the floor, NaN for a row without information."""
        known = np.isfinite(rows_T) & (rows_T != 0)
        squares = np.sum(np.where(known, rows_T, 0.0) ** 2, axis=0) / np.maximum(known.sum(axis=0), 1)
        floor = self.gap.residue.floor_T
        is_known = known.any(axis=0) & np.isfinite(floor) & (floor > 0)
        ratio: FloatArray = np.divide(np.sqrt(squares), floor, out=np.full(len(floor), np.nan), where=is_known)
        return ratio

    @cached_property
    def rows(self) -> tuple[int, ...]:
        """The rows to draw: those with the largest residual in the place of the gap, and in that of each cause."""
        gap = self.gap
        places = [(gap.where.sensors, gap.where.axes), *((cause.sensors, cause.axes) for cause in gap.causes)]
        return tuple(dict.fromkeys(self._largest(*place) for place in places))[:_SHOWN_ROWS]

    def _largest(self, sensors: Sequence[int | str], axes: Sequence[str]) -> int:
        """Return the row with the largest residual in a place; of all rows where there is no place."""
        ratio = np.nan_to_num(self.states[0].ratio)
        is_place = np.zeros(len(ratio), dtype=bool)
        columns = ["xyz".index(axis) for axis in axes] or [0, 1, 2]
        for sensor in sensors:
            is_place[[-1] if sensor == "scalar" else [3 * (int(sensor) - 1) + axis for axis in columns]] = True
        return int(np.argmax(np.where(is_place | ~is_place.any(), ratio, -1.0)))

    def row_name(self, row: int) -> str:
        """Return "sensor 2 x" or "scalar"."""
        return "scalar" if row == 3 * self.sensor_count else f"sensor {row // 3 + 1} {'xyz'[row % 3]}"
