"""Rows that each contain the readings of one moment, whatever file they come from, and their samples."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tam_calibration.core.interpolation import without_delays
from tam_calibration.messages.missing import Missing, in_words
from tam_calibration.messages.point_cloud import is_channel
from tam_calibration.messages.samples import Progress, Samples, Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.channel_map import Clock, Reading, TimeColumn
from tam_calibration.recordings.joining import Joining, Streams, samples_of
from tam_calibration.recordings.tables import Batches, Columns, MemorySource, Table, Wanted, by_stream, fields_of
from tam_calibration.recordings.times import Times, even_times, repaired, stamps_of_numbers, stamps_of_words, time_unit
from tam_calibration.recordings.vectors import is_own_column

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
    """

    def __init__(
        self, path: Path, format: str, columns: Sequence[str], numeric: Sequence[str], time: TimeColumn
    ) -> None:
        self.path, self.format, self.unfinished, self._columns = path, format, "", tuple(columns)
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
        first = self._columns[0]
        others = [name for name in self._columns if not is_own_column(name) and (name == first or name not in numeric)]
        fitting = (name for name in named or others if self._is_time(name, name in numeric))
        name = next(fitting, next(iter(named), None))
        return name, "" if name is None else time.format or named.get(name, "")

    def _is_time(self, column: str, is_numeric: bool) -> bool:
        """Whether a column of another name may be the time: it rises from row to row, or has changing times of day."""
        return False

    def rows(self, fields: Sequence[str]) -> Iterator[tuple[Sequence[str] | FloatArray | None, FloatArray]]:
        """Yield the cells of the time, None where there is no such column, and the (n, fields) numbers of some rows."""
        raise NotImplementedError

    def all_rows(self, fields: Sequence[str]) -> tuple[Sequence[str] | FloatArray | None, FloatArray]:
        """Return cells and numbers of all rows, as `rows` yields them."""
        parts = list(self.rows(fields)) or [(None, np.empty((0, len(fields))))]
        return joined_cells([cells for cells, _ in parts]), np.concatenate([values for _, values in parts])

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
            stamps, unit = stamps_of_numbers(cells, self.time_unit)
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
        cells, values = self.all_rows(fields)
        times = self.timed(cells, len(values))
        self.tell(times)
        table = Table(name, fields, columns=self._columns, count=len(values))
        kept = times.is_kept
        return Columns(table, times.stamps_ns[kept], dict(zip(fields, values[kept].T, strict=True)))

    def batches(self, wanted: Mapping[str, Wanted], clock: Clock, progress: Progress) -> Batches:
        """Yield the readings of some streams, as `Source.batches`, each row's at one time."""
        yield from MemorySource(self.path, self.format, [self.in_memory("")]).batches(wanted, clock, progress)


def joined_cells(parts: Sequence[Any]) -> Any:
    """Return the cells of the time of several pieces as one."""
    if parts[0] is None:
        return None
    return np.concatenate(parts) if isinstance(parts[0], np.ndarray) else [cell for part in parts for cell in part]


class RowJoining:
    """Makes samples of rows. Sensors that are read in turn, so that few rows hold all, are joined by time.

    Parameters
    ----------
    source : RowSource
        An open table.
    streams : Streams
        What is read of it.
    reading : Reading
        How it is read.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    """

    def __init__(self, source: RowSource, streams: Streams, reading: Reading, array: Array | None) -> None:
        self.source, self.streams, self._reading, self._array = source, streams, reading, array
        self._fields = fields_of(streams.wanted)
        self.intakes = streams.intakes(reading, array)
        self._missing, self._count, self._whole = Missing(), 0, 0
        self._read: set[str] = set()
        self._first_ns: int | None = None

    def whole(self, progress: Progress = lambda done, total: None) -> Samples:
        """Return the samples of all rows at once.

        Raises
        ------
        InputError
            When a row is no row of numbers, or too many readings are missing.
        """
        cells, values = self.source.all_rows(self._fields)
        if not len(values):
            raise InputError("it contains no sample")
        samples = self._samples(cells, values, self.source.timed(cells, len(values)))
        self.streams.require_half(self._missing, self._reading)
        if self._are_in_turn:
            return Joining(self.source, self.streams, self._reading, self._array).whole(progress)
        return self._finished(samples)

    @property
    def _are_in_turn(self) -> bool:
        """Whether the sensors are read in turn: less than half of the rows until now hold all of them."""
        return not self._reading.with_partial and self._whole < 0.5 * self._count

    def pieces(self, progress: Progress) -> Iterator[Samples]:
        """Yield the samples in pieces of some ten thousand rows; a channel without a value in one is None there.

        Raises
        ------
        InputError
            As `whole`; pieces before the fault have been yielded by then.
        """
        if self._array is not None and self._array.stamp_delay_s is not None:
            yield self.whole(progress)
            return
        cells, values = self.source.all_rows(())  # what is repaired of times depends on all
        last, times, count = None, self.source.timed(cells, len(values)), 0
        for cells, values in self.source.rows(self._fields):
            samples = self._samples(cells, values, times.of(slice(count, count + len(values))))
            count += len(values)
            if last is None and self._are_in_turn:  # all rows tell whether they are, or a sensor began late
                yield RowJoining(self.source, self.streams, self._reading, self._array).whole(progress)
                return
            if samples is not None:
                if last is not None:
                    yield last
                last = samples
        yield self._finished(last)

    def _finished(self, samples: Samples | None) -> Samples:
        """Return the last samples with the usage of all.

        Raises
        ------
        InputError
            When there are none, or too many readings are missing.
        """
        self.streams.require_half(self._missing, self._reading)
        if samples is None:
            raise InputError("it contains no sample that lies within --from and --until and has all sensors")
        doubts = () if self._array is None else self.streams.other_frames(self._array.mounting)
        unread = self.streams.wanted.keys() - self._read
        lost = tuple(f"all {self._count} readings of {in_words(name)} are missing" for name in sorted(unread))
        if self._missing.counts or doubts or lost:
            missing = self._missing.sentences()
            usage = Usage(self._whole, self._count, lost=lost, missing=missing, other_frames=doubts)
            return replace(samples, usage=usage)
        return samples

    def _samples(self, cells: Sequence[str] | FloatArray | None, values: FloatArray, times: Times) -> Samples | None:
        """Return the samples of some rows; None where none is wanted."""
        if not len(values):
            return None
        self.source.tell(times)
        if self._first_ns is None:
            self._first_ns = int(times.stamps_ns[0])
        inside = times.is_kept & self._reading.window.contains(times.stamps_ns, self._first_ns)
        stamps_ns, values = times.stamps_ns[inside], values[inside]
        if not len(values):
            return None
        rows = np.column_stack([self._time_s(cells, inside, stamps_ns), self._columns(values, stamps_ns)])
        is_missing = np.isnan(rows[:, 1 : 1 + 3 * self.streams.layout.sensor_count])
        is_complete = ~is_missing.any(axis=1)
        self._count += len(rows)
        self._whole += int(is_complete.sum())
        rows = rows[~is_missing.all(axis=1) if self._reading.with_partial else is_complete]
        if not len(rows):
            return None
        samples = samples_of(self.streams.layout, rows)
        recording = samples.recording
        first_s, last_s = recording.time_span_s
        # No array is read a million times a second.
        if last_s - first_s < 1e-6 * (recording.sample_count - 1):
            raise InputError(
                f"{recording.sample_count} samples in {last_s - first_s:g} s: the time must be in seconds, or its "
                "format be stated in a map"
            )
        if self._array is not None:
            recording = self._array.mounting.turned(recording)
            if self._array.stamp_delay_s is not None:
                recording = without_delays(recording, self._array.stamp_delay_s)
        return replace(samples, recording=recording)

    def _time_s(self, cells: Any, inside: np.ndarray, stamps_ns: IntArray) -> FloatArray:
        """Return times in seconds; those of a file in seconds as they stand there, to the last digit."""
        if isinstance(cells, np.ndarray) and cells.dtype.kind == "f" and self.source.time_unit == "s":
            own: FloatArray = cells[inside]
            if (np.diff(own) > 0).all():
                return own
        return stamps_ns / 1e9

    def _columns(self, values: FloatArray, stamps_ns: IntArray) -> FloatArray:
        """Return the values of all streams in SI, in the order of a sample's columns; NaN where one is missing."""
        taken = {}
        for stream, raw in by_stream(self.streams.wanted, values).items():
            in_si, codes = self.intakes[stream].take(raw)
            self._missing.add(stream, codes, (stamps_ns - (self._first_ns or 0)) / 1e9)
            taken[stream] = np.where(codes[:, None] > 0, np.nan, in_si)
            if not np.isnan(taken[stream]).all():
                self._read.add(stream)
        sensors = (name for name in taken if not is_channel(name))
        return np.column_stack([taken[name] for name in (*sensors, *self.streams.layout.channels)])
