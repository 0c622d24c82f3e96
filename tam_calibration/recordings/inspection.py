"""Looks at a recording: what it contains, what is odd, and what would be taken of it for what."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tam_calibration.files.text_files import in_file
from tam_calibration.messages.missing import HUGE, in_words
from tam_calibration.messages.samples import Progress
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.channel_map import ChannelMap, Clock
from tam_calibration.recordings.choice import Choice, choose, reason
from tam_calibration.recordings.formats import open_source, rows_of
from tam_calibration.recordings.inspection_result import (
    Course,
    InspectedChannel,
    InspectedTable,
    Inspection,
    completed_map,
    unit_doubt,
)
from tam_calibration.recordings.intake import field_size, likely_unit
from tam_calibration.recordings.oddities import missing_of, of_readings, of_times, thinned, without_overlap
from tam_calibration.recordings.reading import Reading
from tam_calibration.recordings.resolving import resolve
from tam_calibration.recordings.row_source import RowSource
from tam_calibration.recordings.series import Series, read_messages, read_rows
from tam_calibration.recordings.tables import Columns, MemorySource, Source, Wanted
from tam_calibration.recordings.vectors import attitudes_in, is_magnetic, unit_in, vectors_in


def inspect(
    path: str | Path | Sequence[str | Path],
    array: Array | None = None,
    progress: Progress = lambda done, total: None,
) -> Inspection:
    """Inspect a recording: its channels, what is odd, and what would be taken as sensors and channels.

    Parameters
    ----------
    path : str, Path or sequence of them
        A recording of any format, or the files of one recording, each a table of rows in the same folder.
    array : Array, optional
        Its number of sensors, their frames and the field in which it is turned help to choose.
    progress : callable
        Called now and then with what is done, and how much there is to do.

    Returns
    -------
    Inspection
        Numbers as they were recorded, times in seconds.

    Raises
    ------
    InputError
        When a file cannot be read.

    Examples
    --------
    >>> from tam_calibration import inspect, read_scenario, simulate
    >>> simulate(read_scenario("wu_table_1")).recording.to_pandas().to_csv("run.csv")
    >>> [(table.count, table.rate_hz, table.time) for table in inspect("run.csv").tables]
    [(360, 1.0, 'column time_s [s]')]
    """
    files = [Path(path)] if isinstance(path, str | Path) else [Path(each) for each in path]
    with ExitStack() as stack:
        sources = [stack.enter_context(open_source(file)) for file in files]
        if len(files) > 1:
            _require_together(files, sources)
        series: list[Series] = []
        for file, source in zip(files, sources, strict=True):
            with in_file(file):
                series += _series(source, file.name if len(files) > 1 else "", progress)
        source = sources[0] if len(files) == 1 else _as_one(files[0].parent, series)
        found = _Inspecting(source, series, array)
        tables = found.tables()
        taken = {channel.taken_as: channel for table in tables for channel in table.channels if channel.taken_as}
        channels = {stream: taken[_words(stream)] for stream in found.wanted if _words(stream) in taken}
        channel_map = found.choice.channel_map
        if channel_map is not None:
            channel_map = completed_map(channel_map, channels, sources, found.is_received)
        reasons = tuple(found.reasons(channels))
        doubts, remarks = found.doubts(channels), found.choice.remarks
        return Inspection(tuple(files), source.format, found.duration_s, tables, channel_map, reasons, doubts, remarks)


def _require_together(files: Sequence[Path], sources: Sequence[Source]) -> None:
    """Check that several files can be one recording."""
    for file, source in zip(files, sources, strict=True):
        rows_of(source)
        if file.resolve().parent != files[0].resolve().parent:
            raise InputError(f"{file} lies in another folder than {files[0]}: put the files of a recording into one")
    if len({file.name for file in files}) < len(files):
        raise InputError("a file is given twice")


def _series(source: Source, name: str, progress: Progress) -> list[Series]:
    return [read_rows(source, name, progress)] if isinstance(source, RowSource) else read_messages(source, progress)


class _Inspecting:
    """One recording that was read, and the choice made of it.

    Parameters
    ----------
    source : Source
        The recording.
    series : sequence of Series
        What was read of it.
    array : Array, optional
        What is known of the array.
    """

    def __init__(self, source: Source, series: Sequence[Series], array: Array | None) -> None:
        self._series, self._bounds = series, Reading.bounds(array)
        self.choice = _chosen(source, array)
        self.wanted, self._clock, self._fault = _resolved(source, self.choice.channel_map)
        times = [each.times_ns for each in series if each.times_ns is not None and len(each.times_ns)]
        self._begin_ns = min((int(each.min()) for each in times), default=0)
        self.duration_s = (max(int(each.max()) for each in times) - self._begin_ns) / 1e9 if times else float("nan")

    def tables(self) -> tuple[InspectedTable, ...]:
        """Return what each table contains."""
        with np.errstate(all="ignore"):  # columns of any meaning hold numbers of any size
            return tuple(self._table(each) for each in self._series)

    def _table(self, series: Series) -> InspectedTable:
        table, times_ns = series.table, series.times_ns
        count = table.count if table.count is not None else len(series.values) or None
        span_s = self.duration_s if times_ns is None or not len(times_ns) else float(np.ptp(times_ns)) / 1e9
        rate_hz = (count - 1) / span_s if count and span_s else float("nan")
        magnetic = {each.fields for each in vectors_in(table) if is_magnetic(each)}
        channels = tuple(
            self._channel(series, fields, stream, _is_field(stream) if stream else fields in magnetic)
            for fields, stream in self._channels_of(series)
        )
        time = "the recorder's times" if series.are_stamps_zero else series.time
        return InspectedTable(table.title, table.type, count, rate_hz, time, tuple(of_times(series)), channels)

    def _channels_of(self, series: Series) -> Iterator[tuple[tuple[str, ...], str]]:
        """Yield the fields of each channel and its stream: first those that are taken, then vectors, then numbers."""
        free = set(series.fields)
        taken = [(each.fields, stream) for stream, each in self.wanted.items() if each.table.key == series.table.key]
        vectors = [vector.fields for vector in vectors_in(series.table)]
        quaternions = [tuple(map(str, pick.paths)) for pick in attitudes_in(replace(series.table, type=""))]
        for fields, stream in [*taken, *((each, "") for each in (*vectors, *quaternions, *zip(series.fields)))]:
            if free >= set(fields):
                free -= set(fields)
                yield fields, stream

    def _channel(self, series: Series, fields: tuple[str, ...], stream: str, is_field: bool) -> InspectedChannel:
        values = series.of(fields)
        codes, missing = missing_of(values, is_field)
        there = values[codes == 0] if codes.any() else values
        size = field_size(thinned(there)) if is_field else float("nan")
        stated = unit_in(series.table, fields[0]) if is_field else ""
        low, high = (there.min(axis=0), there.max(axis=0)) if len(there) else 2 * (np.full(len(fields), np.nan),)
        return InspectedChannel(
            fields,
            _words(stream),
            tuple(low.tolist()),
            tuple(high.tolist()),
            size,
            likely_unit(size, stated, self._bounds),
            stated,
            missing,
            tuple(of_readings(values, is_field, codes, series.times_ns)),
            self._course(series, values),
        )

    def _course(self, series: Series, values: FloatArray) -> Course:
        """Return the smallest and the largest of many consecutive values; sentinels beyond any scale are left out."""
        values = np.where(np.abs(values) < HUGE, values, np.nan)
        times_ns = series.times_ns
        time_s = np.arange(len(values)) * 1.0 if times_ns is None else (times_ns - self._begin_ns) / 1e9
        # A thousand parts, each with its smallest and largest value, so that a spike is seen.
        starts = np.arange(0, len(values), len(values) // 1000 + 1)
        if not len(starts):
            return Course(time_s, values, values)
        return Course(time_s[starts], np.fmin.reduceat(values, starts), np.fmax.reduceat(values, starts))

    def doubts(self, channels: Mapping[str, InspectedChannel]) -> tuple[str, ...]:
        """Return why the choice is ambiguous or not enough, each with what to add.

        Parameters
        ----------
        channels : mapping of str to InspectedChannel
            What is taken, by stream.
        """
        faults = [each.fault for each in self._of_streams().values() if each.fault]
        fields = {stream: each for stream, each in channels.items() if _is_field(stream)}
        units = [unit_doubt(stream, each, self._has_sure_unit(stream)) for stream, each in fields.items()]
        advice = ": state time: received in the map, to join them by the recorder's times" if self.is_received else ""
        apart = [f"{self._apart}{advice}"] if self._apart else []
        return tuple(dict.fromkeys(filter(None, [*self.choice.doubts, *self._fault, *faults, *units, *apart])))

    def _has_sure_unit(self, stream: str) -> bool:
        """Whether the stated unit is reliable: stated by our own names or those of columns, not only by a type."""
        chosen = self.choice.channel_map
        return self.choice.is_own or (chosen is not None and chosen.streams[stream].unit != "")

    def _of_streams(self) -> dict[str, Series]:
        by_table = {each.table.key: each for each in self._series}
        return {stream: by_table[wanted.table.key] for stream, wanted in self.wanted.items()}

    @cached_property
    def _apart(self) -> str:
        """Return which two of the streams that are joined by stamps have none at the same time; empty of none."""
        own = {stream: each.stamps_ns for stream, each in self._of_streams().items()}
        stamped = [(in_words(name), each) for name, each in own.items() if each is not None and len(each)]
        return without_overlap(stamped) if stamped and self._clock == "stamp" else ""

    @property
    def is_received(self) -> bool:
        """Whether messages have to be joined by the recorder's times."""
        has_clock = any(each.received_ns is not None for each in self._of_streams().values())
        return has_clock and (self._clock == "received" or self._apart != "")

    def reasons(self, channels: Mapping[str, InspectedChannel]) -> Iterator[str]:
        """Yield what is taken for what, and why.

        Parameters
        ----------
        channels : mapping of str to InspectedChannel
            What is taken, by stream.
        """
        for stream, channel in channels.items():
            wanted = self.wanted[stream]
            what = ", ".join(part for part in (wanted.table.title, channel.title) if part)
            how = "stated" if channel.is_unit_stated else "detected by the size of the field"
            size = channel.size * channel.nanotesla
            unit = f"; field {size:.6g} nT, unit {channel.unit} ({how})" if channel.unit else ""
            yield f"{channel.taken_as}: {what}, by {reason(stream, wanted)}{unit}"


def _as_one(folder: Path, series: Sequence[Series]) -> Source:
    """Return several files as one recording, to choose of it."""
    empty = [Columns(each.table, np.empty(0, dtype=np.int64), {}) for each in series]
    return MemorySource(folder, f"{len(series)} files", empty)


def _chosen(source: Source, array: Array | None) -> Choice:
    try:
        return choose(source, *((None, None) if array is None else (array.sensor_count, array.mounting.frame_ids)))
    except InputError as problem:
        return Choice(None, (str(problem),))


def _resolved(source: Source, channel_map: ChannelMap | None) -> tuple[dict[str, Wanted], Clock, tuple[str, ...]]:
    """Return the table and the fields of each stream, the clock of all, or why they are not known."""
    if channel_map is None:
        return {}, "stamp", ()
    try:
        streams = resolve(source, channel_map)
    except InputError as problem:
        return {}, "stamp", (str(problem),)
    return dict(streams.wanted), streams.clock, ()


def _is_field(stream: str) -> bool:
    return stream == "scalar" or stream.startswith("tam_")


def _words(stream: str) -> str:
    return in_words(stream).removeprefix("the ") if stream else ""
