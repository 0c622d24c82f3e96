"""Looks at a recording: what it contains, what is odd, what would be taken for what, as a map to edit and as JSON."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, cast

import numpy as np

from tam_calibration.files.text_files import in_file
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.messages.missing import HUGE, in_words
from tam_calibration.messages.samples import Progress
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla
from tam_calibration.recordings import oddities
from tam_calibration.recordings.channel_map import ChannelMap, Clock, Pick, TextFormat, TimeColumn, map_to_mapping
from tam_calibration.recordings.choice import Choice, choose, reason, resolve
from tam_calibration.recordings.intake import field_size, is_of_field, likely_unit, size_doubt
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.oddities import Series, read_messages, read_rows, thinned
from tam_calibration.recordings.recording_file import open_source, rows_of
from tam_calibration.recordings.row_source import RowSource
from tam_calibration.recordings.tables import Columns, MemorySource, Source
from tam_calibration.recordings.text_source import TextSource
from tam_calibration.recordings.vectors import attitudes_in, is_magnetic, unit_in, vectors_in

_NAMES = 6
"""Tables and channels that are named as showing the same: a log has hundreds."""


@dataclass(frozen=True, eq=False)
class Course:
    """The smallest and the largest values of a channel over time.

    Parameters
    ----------
    time_s : (m,) array
        Seconds from the beginning of the recording; rows, where there is no time.
    low, high : (m, width) array
        As they were recorded.
    """

    time_s: FloatArray
    low: FloatArray
    high: FloatArray


@dataclass(frozen=True, eq=False)
class InspectedChannel:
    """A vector, a quaternion or a number of a table.

    Parameters
    ----------
    fields : tuple of str
        Its paths or columns.
    taken_as : str
        Such as ``sensor 1`` or ``scalar``; empty where it is not taken.
    low, high : tuple of float
        Range of each field, without missing readings, as recorded.
    size : float
        Of the magnetic field that it reads, as recorded; NaN of others.
    unit : str
        Of that field, as stated, unless another fits better; empty where it is not known.
    stated_unit : str
        As the format or a name states it; empty where neither does.
    missing : mapping of str to int
        Number of missing readings by their reason.
    oddities : tuple of str
        What is odd, a clause each.
    course : Course
        Over time.
    """

    fields: tuple[str, ...]
    taken_as: str
    low: tuple[float, ...]
    high: tuple[float, ...]
    size: float
    unit: str
    stated_unit: str
    missing: Mapping[str, int]
    oddities: tuple[str, ...]
    course: Course = field(repr=False)

    @property
    def is_unit_stated(self) -> bool:
        """Whether the unit is that which is stated; else it was detected by the size of the field."""
        return self.unit != "" and self.unit == self.stated_unit

    @property
    def nanotesla(self) -> float:
        """How many nT one of its units is; NaN where that is not known."""
        return to_nanotesla(TESLA_PER_FIELD_UNIT[self.unit]) if self.unit else float("nan")

    @property
    def title(self) -> str:
        """Its fields for people: a vector by what its paths have in common."""
        parents = {path.rpartition(".")[0] for path in self.fields}
        is_vector = len(self.fields) > 1 and len(parents) == 1 and "" not in parents
        return parents.pop() if is_vector else ", ".join(self.fields)


@dataclass(frozen=True, eq=False)
class InspectedTable:
    """A topic, a message of a log or a text file.

    Parameters
    ----------
    name : str
        Topic or file, with the number of an instance.
    type : str
        Of a topic's messages.
    count : int or None
        Messages or rows; None where it is not known.
    rate_hz : float
        In the mean; NaN where it is not known.
    time : str
        Where its time comes from; empty where it was not read.
    oddities : tuple of str
        What is odd about its times, a clause each.
    channels : tuple of InspectedChannel
        Its vectors, quaternions and numbers; none of images, clouds and unknown types.
    """

    name: str
    type: str
    count: int | None
    rate_hz: float
    time: str
    oddities: tuple[str, ...]
    channels: tuple[InspectedChannel, ...]


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a recording contains, and what would be taken of it.

    Parameters
    ----------
    files : tuple of Path
        What was read.
    format : str
        For people.
    duration_s : float
        From the first to the last message or row; NaN where there is no time.
    tables : tuple of InspectedTable
        Its topics, messages or files.
    channel_map : ChannelMap or None
        The choice, or the best guess; None where nothing can be taken.
    reasons : tuple of str
        What is taken for what, and why.
    doubts : tuple of str
        Why the choice is ambiguous or not enough, with what to add; empty where it can be made.
    remarks : tuple of str
        What is not taken although it may be meant.

    Examples
    --------
    >>> from tam_calibration import inspect, read_scenario, simulate
    >>> simulate(read_scenario("wu_table_1")).recording.to_pandas().to_csv("run.csv")
    >>> found = inspect("run.csv")
    >>> found.is_certain, found.duration_s, len(found.channel_map.sensors), found.oddities
    (True, 359.0, 4, ())
    """

    files: tuple[Path, ...]
    format: str
    duration_s: float
    tables: tuple[InspectedTable, ...]
    channel_map: ChannelMap | None
    reasons: tuple[str, ...]
    doubts: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def is_certain(self) -> bool:
        """Whether a choice can be made."""
        return self.channel_map is not None and not self.doubts

    @property
    def oddities(self) -> tuple[str, ...]:
        """What is odd about the complete recording: each clause behind what shows it, first that of what is taken."""
        shown: dict[str, list[tuple[bool, str]]] = {}
        for table in self.tables:
            is_free = not any(channel.taken_as for channel in table.channels)
            for clause in table.oddities:
                shown.setdefault(clause, []).append((is_free, table.name))
            for channel in table.channels:
                name = channel.taken_as or f"{table.name} {channel.title}".strip()
                for clause in channel.oddities:
                    shown.setdefault(clause, []).append((not channel.taken_as, name))
        clauses = [(all(free for free, _ in names), _listed(names), clause) for clause, names in shown.items()]
        clauses.sort(key=lambda each: each[0])
        return tuple(": ".join(filter(None, (names, clause))) for _, names, clause in clauses)

    def map_yaml(self) -> str:
        """Return a map to edit, with what is ambiguous as comments.

        Returns
        -------
        str
            Text of the YAML file. It has no sensors where none is found.
        """
        names = ", ".join(file.name for file in self.files)
        said = [f"What is taken of {names}. Edit it, and give it with --map."]
        said += [f"To settle: {clause}" for clause in (*self.doubts, *self.remarks)]
        text = "sensors: []\n" if self.channel_map is None else dump_mapping(map_to_mapping(self.channel_map))
        return "".join(f"# {' '.join(line.split())}\n" for line in said) + text


def _listed(names: Sequence[tuple[bool, str]]) -> str:
    """Return some names, first those of what is taken, and how many more there are."""
    listed = [name for _, name in sorted(names, key=lambda each: each[0])]
    more = [f"{len(listed) - _NAMES} more"] if len(listed) > _NAMES else []
    return ", ".join([*listed[:_NAMES], *more])


def _name_of(stream: str) -> str:
    """Return the name of what is taken as a stream, such as ``sensor 1`` or ``scalar``."""
    return in_words(stream).removeprefix("the ")


def _with_unit(pick: Pick, channel: InspectedChannel | None) -> Pick:
    """Return a pick with the unit that was detected, where none is stated or another fits better."""
    if channel is None or not channel.unit or channel.is_unit_stated:
        return pick
    return replace(pick, unit=cast(Any, channel.unit))


def _time(source: RowSource) -> Clock | TimeColumn:
    column = source.time_column
    if column is None:
        return "stamp"
    return TimeColumn(column=int(column) if column.isdigit() else column, format=source.time_unit or "iso8601")


def _text(source: TextSource) -> TextFormat:
    dialect = source.dialect
    return TextFormat(
        delimiter=dialect.delimiter,
        decimal="," if dialect.decimal == "," else ".",
        header_line=None if dialect.has_header else 0,
        comment=dialect.comment or None,
    )


_SCHEMA = "tam_calibration/inspection/1"


def inspection_to_mapping(found: Inspection) -> dict[str, Any]:
    """Return the content of an inspection's JSON.

    Parameters
    ----------
    found : Inspection
        What a recording contains. Courses over time are left out.
    """
    content = asdict(found) | {"files": [str(file) for file in found.files], "is_certain": found.is_certain}
    content["channel_map"] = None if found.channel_map is None else map_to_mapping(found.channel_map)
    for table, inspected in zip(content["tables"], found.tables, strict=True):
        for channel, own in zip(table["channels"], inspected.channels, strict=True):
            del channel["course"]
            if own.unit:
                channel["size_nT"] = own.size * own.nanotesla
                for name in ("low", "high"):
                    channel[f"{name}_nT"] = [value * own.nanotesla for value in channel[name]]
    return {"schema": _SCHEMA, **content}


def inspect(
    path: str | Path | Sequence[str | Path], array: Array | None = None, progress: Progress = lambda done, total: None
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
                name = file.name if len(files) > 1 else ""
                if isinstance(source, RowSource):
                    series.append(read_rows(source, name, progress))
                else:
                    series += read_messages(source, progress)
        source = sources[0]
        if len(files) > 1:
            columns = [Columns(each.table, np.empty(0, dtype=np.int64), {}) for each in series]
            source = MemorySource(files[0].parent, f"{len(files)} files", columns)
        found = _Inspecting(source, series, array)
        read = tuple(files), source.format, found.duration_s, found.tables
        reasons, doubts, remarks = tuple(found.reasons()), found.doubts(), found.choice.remarks
        return Inspection(*read, found.channel_map(sources), reasons, doubts, remarks)


def _require_together(files: Sequence[Path], sources: Sequence[Source]) -> None:
    """Check that several files can be one recording."""
    for file, source in zip(files, sources, strict=True):
        rows_of(source)
        if file.resolve().parent != files[0].resolve().parent:
            raise InputError(f"{file} lies in another folder than {files[0]}: put the files of a recording into one")
    if len({file.name for file in files}) < len(files):
        raise InputError("a file is given twice")


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
        self._bounds = EARTH_FIELD if array is None else array.field
        self.choice, self._streams, self._fault = Choice(None), Streams({}, {}, "stamp"), ""
        try:
            frame_ids = None if array is None else array.mounting.frame_ids
            self.choice = choose(source, None if array is None else array.sensor_count, frame_ids)
            if self.choice.channel_map is not None:
                self._streams = resolve(source, self.choice.channel_map)
        except InputError as problem:
            self._fault = str(problem)
        by_table = {each.table.key: each for each in series}
        self._of_streams = {stream: by_table[wanted.table.key] for stream, wanted in self._streams.wanted.items()}
        times = [each.times_ns for each in series if each.times_ns is not None and len(each.times_ns)]
        self._begin_ns = min((int(each.min()) for each in times), default=0)
        self.duration_s = (max(int(each.max()) for each in times) - self._begin_ns) / 1e9 if times else float("nan")
        with np.errstate(all="ignore"):  # columns of any meaning hold numbers of any size
            self.tables = tuple(self._table(each) for each in series)
        taken = {channel.taken_as: channel for table in self.tables for channel in table.channels}
        self.channels = {stream: taken[name] for stream in self._streams.wanted if (name := _name_of(stream)) in taken}

    def _table(self, series: Series) -> InspectedTable:
        table, times_ns = series.table, series.times_ns
        count = table.count if table.count is not None else len(series.values) or None
        span_s = self.duration_s if times_ns is None or not len(times_ns) else float(np.ptp(times_ns)) / 1e9
        rate_hz = (count - 1) / span_s if count and span_s else float("nan")
        magnetic = {each.fields for each in vectors_in(table) if is_magnetic(each)}
        channels = []
        for fields, stream in self._channels_of(series):
            is_field = is_of_field(stream) if stream else fields in magnetic
            channels.append(self._channel(series, fields, stream, is_field))
        time = "the recorder's times" if series.are_stamps_zero else series.time
        return InspectedTable(
            table.title, table.type, count, rate_hz, time, tuple(oddities.of_times(series)), tuple(channels)
        )

    def _channels_of(self, series: Series) -> Iterator[tuple[tuple[str, ...], str]]:
        """Yield the fields of each channel and its stream: first those that are taken, then vectors, then numbers."""
        free = set(series.fields)
        wanted = self._streams.wanted.items()
        taken = [(each.fields, stream) for stream, each in wanted if each.table.key == series.table.key]
        vectors = [vector.fields for vector in vectors_in(series.table)]
        quaternions = [tuple(map(str, pick.paths)) for pick in attitudes_in(replace(series.table, type=""))]
        for fields, stream in [*taken, *((each, "") for each in (*vectors, *quaternions, *zip(series.fields)))]:
            if free >= set(fields):
                free -= set(fields)
                yield fields, stream

    def _channel(self, series: Series, fields: tuple[str, ...], stream: str, is_field: bool) -> InspectedChannel:
        values = series.of(fields)
        codes, missing = oddities.missing_of(values, is_field)
        there = values[codes == 0] if codes.any() else values
        size = field_size(thinned(there)) if is_field else float("nan")
        stated = unit_in(series.table, fields[0]) if is_field else ""
        unit = likely_unit(size, stated, self._bounds)
        seen = there if len(there) else np.full((1, len(fields)), np.nan)
        low, high = tuple(seen.min(axis=0).tolist()), tuple(seen.max(axis=0).tolist())
        name = _name_of(stream) if stream else ""
        odd = tuple(oddities.of_readings(values, is_field, codes, series.times_ns))
        course = self._course(series, values)
        return InspectedChannel(fields, name, low, high, size, unit, stated, missing, odd, course)

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

    def channel_map(self, sources: Sequence[Source]) -> ChannelMap | None:
        """Return the choice with units that were detected, where the time is, and how text files are written."""
        chosen = self.choice.channel_map
        if chosen is None:
            return None
        picks = {stream: _with_unit(pick, self.channels.get(stream)) for stream, pick in chosen.streams.items()}
        sensors = [pick for stream, pick in picks.items() if stream.startswith("tam_")]
        found = replace(chosen, sensors=sensors, scalar=picks.get("scalar"))
        if self.is_received:
            return replace(found, time="received")
        rows = [each for each in sources if isinstance(each, RowSource)]
        times = [_time(each) for each in rows]
        if times and all(each == times[0] for each in times):
            found = replace(found, time=times[0])
        texts = [_text(each) for each in rows if isinstance(each, TextSource)]
        return replace(found, text=texts[0]) if texts and all(each == texts[0] for each in texts) else found

    def doubts(self) -> tuple[str, ...]:
        """Return why the choice is ambiguous or not enough, each with what to add."""
        faults = [self._fault, *(each.fault for each in self._of_streams.values())]
        fields = {stream: each for stream, each in self.channels.items() if is_of_field(stream)}
        units = [self._unit_doubt(stream, each) for stream, each in fields.items()]
        advice = ": state time: received in the map, to join them by the recorder's times" if self.is_received else ""
        apart = f"{self._apart}{advice}" if self._apart else ""
        return tuple(dict.fromkeys(filter(None, [*self.choice.doubts, *faults, *units, apart])))

    def _unit_doubt(self, stream: str, channel: InspectedChannel) -> str:
        """Return why the unit of a field has to be stated; empty where it is known.

        What our own names or those of columns state is sure; what only a type states is not, where the size of the
        field tells another.
        """
        name, size, chosen = in_words(stream), channel.size, self.choice.channel_map
        if not size > 0:
            return f"{name} has no reading of a field: take something else in the map"
        is_sure = self.choice.is_own or (chosen is not None and chosen.streams[stream].unit != "")
        if channel.unit and (not is_sure or channel.stated_unit in ("", channel.unit)):
            return ""
        if not channel.stated_unit:
            return size_doubt(stream, size)
        stated = f"{channel.stated_unit} as stated, which is not the Earth's"
        advice = f"unit {channel.unit}" if channel.unit else "unit or scale_nT"
        return f"{name} reads a field of about {size:.3g} {stated}: state {advice} in the map"

    @cached_property
    def _apart(self) -> str:
        """Return which two of the streams that are joined by stamps have none at the same time; empty of none."""
        own = {stream: each.stamps_ns for stream, each in self._of_streams.items()}
        stamped = [(in_words(name), each) for name, each in own.items() if each is not None and len(each)]
        return oddities.without_overlap(stamped) if stamped and self._streams.clock == "stamp" else ""

    @property
    def is_received(self) -> bool:
        """Whether messages have to be joined by the recorder's times."""
        has_clock = any(each.received_ns is not None for each in self._of_streams.values())
        return has_clock and (self._streams.clock == "received" or self._apart != "")

    def reasons(self) -> Iterator[str]:
        """Yield what is taken for what, and why."""
        for stream, channel in self.channels.items():
            wanted = self._streams.wanted[stream]
            what = ", ".join(part for part in (wanted.table.title, channel.title) if part)
            how = "stated" if channel.is_unit_stated else "detected by the size of the field"
            size = channel.size * channel.nanotesla
            unit = f"; field {size:.6g} nT, unit {channel.unit} ({how})" if channel.unit else ""
            yield f"{channel.taken_as}: {what}, by {reason(stream, wanted)}{unit}"
