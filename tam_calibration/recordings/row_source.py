"""Rows of numbers with a time each, whatever file they come from."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.messages.samples import Progress
from tam_calibration.messages.stream_messages import StreamMessages
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.channel_map import Clock, TimeColumn
from tam_calibration.recordings.own_names import is_own_column
from tam_calibration.recordings.tables import Columns, MemorySource, Table, Wanted
from tam_calibration.recordings.times import (
    PER_SECOND,
    Times,
    even_times,
    repaired,
    stamps_of_numbers,
    stamps_of_words,
    time_unit,
)

log = logging.getLogger(__name__)

NO_TIME_RATE_HZ = 1.0
"""Rate that rows without a time are given: a fit of the errors needs none."""

_NO_TIME = "without a time, rows count as 1 s apart and rates mean nothing: state time: {rate_hz: …} in a map"


class RowSource:
    """Rows that each hold the readings of one moment.

    Parameters
    ----------
    path : Path
        Where they lie.
    format : str
        For people.
    columns : sequence of str
        Names of all columns.
    numeric : sequence of str
        Those that hold numbers.
    time : TimeColumn
        Where their time is, as far as it is stated.
    has_header : bool
        Whether the names stand in the file.
    """

    def __init__(
        self,
        path: Path,
        format: str,
        columns: Sequence[str],
        numeric: Sequence[str],
        time: TimeColumn,
        has_header: bool = True,
    ) -> None:
        self.path, self.format, self.unfinished, self._columns = path, format, "", tuple(columns)
        self.has_header = has_header
        self.time_column, self.time_unit = self._time(time, numeric)
        self.rate_hz = time.rate_hz
        self._reported: set[str] = set()
        fields = tuple(name for name in numeric if name != self.time_column)
        self.tables: Sequence[Table] = [Table("", fields, is_stamped=True, columns=self._columns)]

    def _time(self, time: TimeColumn, numeric: Sequence[str]) -> tuple[str | None, str]:
        """Return the column of the time, None where there is none, and its unit or format, as far as that is known."""
        if time.rate_hz is not None:
            return None, ""
        if isinstance(time.column, int):
            if not 1 <= time.column <= len(self._columns):
                raise InputError(f"{self.path} has {len(self._columns)} columns, none with the number {time.column}")
            return self._columns[time.column - 1], time.format
        if time.column is not None:
            if time.column not in self._columns:
                raise InputError(
                    f"{self.path} has no column {quoted(time.column)}: it has {', '.join(self._columns[:12])}"
                )
            return time.column, time.format
        named = {name: unit for name in self._columns if (unit := time_unit(name)) is not None}
        if not named:
            first = self._columns[0]
            return (first, "") if not is_own_column(first) and self._is_time(first, first in numeric) else (None, "")
        name = next(iter(named))
        return name, time.format or named[name]

    def _is_time(self, column: str, is_numeric: bool) -> bool:
        """Whether a column of another name may be the time: it rises from row to row, or contains times of day."""
        return False

    def rows(self, fields: Sequence[str]) -> Iterator[tuple[Sequence[str] | FloatArray | None, FloatArray]]:
        """Yield the cells of the time, None where there is no such column, and the (n, fields) numbers of some rows."""
        raise NotImplementedError

    def times(self) -> Times:
        """Return the times of all rows, for which they are gone through: what is repaired depends on all."""
        parts = list(self.rows(()))
        return self.timed(joined_cells([cells for cells, _ in parts]), sum(len(values) for _, values in parts))

    def timed(self, cells: Sequence[str] | FloatArray | None, count: int) -> Times:
        """Return the times of rows, repaired.

        Parameters
        ----------
        cells : (n,) array, sequence of str or None
            As `rows` yields them.
        count : int
            Number of rows.
        """
        if cells is None:
            stamps_ns = even_times(count, self.rate_hz or NO_TIME_RATE_HZ)
            return Times(stamps_ns, np.ones(count, dtype=bool), () if self.rate_hz else (_NO_TIME,))
        if isinstance(cells, np.ndarray) and cells.dtype.kind == "f":
            stamps, unit = stamps_of_numbers(cells, self.time_unit if self.time_unit in PER_SECOND else "")
            self.time_unit = unit
            return repaired(stamps, unit)
        if isinstance(cells, np.ndarray):  # times of day that a library has read
            return repaired(cells.astype(np.int64), "")
        return repaired(stamps_of_words(cells, self.time_unit), "")

    def tell(self, times: Times) -> None:
        """Warn of what was repaired of times, once."""
        for remark in times.remarks:
            if remark not in self._reported:
                self._reported.add(remark)
                log.warning("%s: %s", self.path, remark)

    def in_memory(self, name: str) -> Columns:
        """Return all rows with their times as a table of some name."""
        fields = self.tables[0].fields
        parts = list(self.rows(fields))
        values = np.concatenate([part for _, part in parts])
        times = self.timed(joined_cells([cells for cells, _ in parts]), len(values))
        self.tell(times)
        table = Table(name, fields, columns=self._columns, count=len(values))
        kept = times.is_kept
        return Columns(table, times.stamps_ns[kept], dict(zip(fields, values[kept].T, strict=True)))

    def batches(
        self, wanted: Mapping[str, Wanted], clock: Clock, progress: Progress
    ) -> Iterator[dict[str, StreamMessages]]:
        """Yield the readings of some streams, as `Source.batches`, each row's at one time."""
        yield from MemorySource(self.path, self.format, [self.in_memory("")]).batches(wanted, clock, progress)


def joined_cells(parts: Sequence[Any]) -> Any:
    """Return the cells of the time of several pieces as one."""
    if not parts or parts[0] is None:
        return None
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else [cell for part in parts for cell in part]
