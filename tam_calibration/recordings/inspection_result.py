"""The result of an inspection: the content of a recording, its oddities, a map of it to edit, and its JSON."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, cast

from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.messages.missing import in_words
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, FloatArray, to_nanotesla
from tam_calibration.recordings.channel_map import ChannelMap, FieldUnit, Pick, TextFormat, TimeColumn, map_to_mapping
from tam_calibration.recordings.intake import size_doubt
from tam_calibration.recordings.row_source import NO_TIME_RATE_HZ, RowSource
from tam_calibration.recordings.tables import Source
from tam_calibration.recordings.text_source import TextSource

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


def unit_doubt(stream: str, channel: InspectedChannel, is_sure: bool) -> str:
    """Return why the unit of a field has to be stated; empty where it is known.

    Parameters
    ----------
    stream : str
        A sensor or the scalar.
    channel : InspectedChannel
        What is taken for it.
    is_sure : bool
        Whether the stated unit is taken even where the size of the field tells another.
    """
    name, size = in_words(stream), channel.size
    if not size > 0:
        return f"{name} has no reading of a field: take something else in the map"
    if channel.unit and (not is_sure or channel.stated_unit in ("", channel.unit)):
        return ""
    if not channel.stated_unit:
        return size_doubt(stream, size)
    stated = f"{channel.stated_unit} as stated, which is not the Earth's"
    advice = f"unit {channel.unit}" if channel.unit else "unit or scale_nT"
    return f"{name} reads a field of about {size:.3g} {stated}: state {advice} in the map"


def completed_map(
    channel_map: ChannelMap, channels: Mapping[str, InspectedChannel], sources: Sequence[Source], is_received: bool
) -> ChannelMap:
    """Return a map with units that were detected, where the time is, and how a text file is written.

    Parameters
    ----------
    channel_map : ChannelMap
        The choice.
    channels : mapping of str to InspectedChannel
        What is taken, by stream.
    sources : sequence of Source
        The files.
    is_received : bool
        Whether messages are joined by the recorder's times.
    """
    picks = {stream: _with_unit(pick, channels.get(stream)) for stream, pick in channel_map.streams.items()}
    sensors = [pick for stream, pick in picks.items() if stream.startswith("tam_")]
    found = replace(channel_map, sensors=sensors, scalar=picks.get("scalar"))
    if is_received:
        return replace(found, time="received")
    rows = [each for each in sources if isinstance(each, RowSource)]
    times = [_time(each) for each in rows]
    if times and all(each == times[0] for each in times):
        found = replace(found, time=times[0])
    texts = [_text(each) for each in rows if isinstance(each, TextSource)]
    return replace(found, text=texts[0]) if texts and all(each == texts[0] for each in texts) else found


def _with_unit(pick: Pick, channel: InspectedChannel | None) -> Pick:
    """Return a pick with the unit that was detected, where none is stated or another fits better."""
    if channel is None or not channel.unit or channel.is_unit_stated:
        return pick
    return replace(pick, unit=cast(FieldUnit, channel.unit))


def _time(source: RowSource) -> TimeColumn:
    if source.time_column is None:
        return TimeColumn(rate_hz=source.rate_hz or NO_TIME_RATE_HZ)
    column = source.time_column
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
