"""The map: which topics, fields or columns of a recording are the sensors of an array and its channels."""

from collections.abc import Mapping
from dataclasses import MISSING, fields, is_dataclass
from dataclasses import field as default_of
from pathlib import Path
from typing import Annotated, Any, Literal

from tam_calibration.files.schema import Bounds, Document, check
from tam_calibration.files.text_files import in_file
from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import require_further, require_sensor_count
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT

FieldUnit = Literal["", "T", "mT", "uT", "nT", "G", "mG"]
"""Unit of a field; empty where it is not stated."""

World = Literal["enu", "ned"]
"""Axes of the world of an attitude or a position."""

CHANNEL_WIDTHS = {"scalar": 1, "attitude": 4, "gyroscope": 3, "temperature": 1, "current": 1, "position": 3}
"""Values of each channel that a recording contains in addition to its sensors."""


class Pick(Document):
    """Where the values of one sensor or channel come from.

    Parameters
    ----------
    topic : str
        Topic of a bag, or message of a log.
    field : str
        Path of a vector (its x, y, z are taken), a quaternion or a number inside the message.
    fields : list of str
        Paths of single numbers instead, in the order of the axes.
    instance : int
        Which of several messages of one name in a log.
    columns : list of str or int
        Columns of a text file or table, by name or counted from 1.
    column : str or int, optional
        The same for a channel of one value.
    file : str
        The file, where a recording is several files.
    unit : str
        Unit of a field; where it is missing the message's definition or the Earth's field tells it.
    scale_nT : float, optional
        Instead of a unit: how many nT one count is.
    type : str
        Type of the topic's messages, such as ``sensor_msgs/msg/Imu``; only the collector needs it.
    world : str
        Of an attitude or a position: the axes of its world, east-north-up or north-east-down.
    """

    topic: str = ""
    field: str = ""
    fields: list[str] = default_of(default_factory=list)
    instance: int = 0
    columns: list[str | int] = default_of(default_factory=list)
    column: str | int | None = None
    file: str = ""
    unit: FieldUnit = ""
    scale_nT: Annotated[float, Bounds(above=0)] | None = None
    type: str = ""
    world: World = "enu"

    def __post_init__(self) -> None:
        """Check that a unit is stated once."""
        if self.unit and self.scale_nT is not None:
            raise InputError("give either unit or scale_nT")

    @property
    def factor(self) -> float | None:
        """Tesla for one of its units; None where it is to be detected."""
        if self.scale_nT is not None:
            return 1e-9 * self.scale_nT
        return TESLA_PER_FIELD_UNIT[self.unit] if self.unit else None

    @property
    def table(self) -> tuple[str, int]:
        """Name and instance of the table that it is in; a text file's name is its file."""
        return self.topic or self.file, self.instance

    @property
    def paths(self) -> list[str | int]:
        """What it names in the table: paths or columns; none where the message's type says it."""
        single = [self.column] if self.column is not None else [self.field] if self.field else []
        return [*self.fields, *self.columns, *single]

    def __str__(self) -> str:
        """Return it for people: topic or file, and what it names there."""
        where = self.topic or self.file
        number = f" [{self.instance}]" if self.instance else ""
        inside = ", ".join(map(str, self.paths))
        unit = self.unit or ("" if self.scale_nT is None else f"{self.scale_nT:g} nT a count")
        unit = "" if unit and all(unit in str(path) for path in self.paths) and self.paths else unit
        has_number = any(isinstance(path, int) for path in self.paths)
        kind = "columns" if len(self.columns) > 1 else "column" if has_number else ""
        return " ".join(part for part in (f"{where}{number}", kind, inside, f"[{unit}]" if unit else "") if part)


class TextFormat(Document):
    """How a text file is written; what is not given is detected.

    Parameters
    ----------
    delimiter, decimal, comment : str, optional
        Between columns (``" "`` is any white space), within numbers, and before lines that are not read.
    header_line : int, optional
        Line of the columns' names, counted from 1; 0 where there is none.
    """

    delimiter: str | None = None
    decimal: Literal[".", ","] | None = None
    header_line: Annotated[int, Bounds(least=0)] | None = None
    comment: str | None = None


class TimeColumn(Document):
    """The time of a text file or table: a column, or a rate where there is none.

    Parameters
    ----------
    column : str or int, optional
        Name of the column, or its number from 1.
    format : str
        ``s``, ``ms``, ``us``, ``ns``, ``iso8601`` or a pattern of ``strptime``; detected where it is empty.
    rate_hz : float, optional
        Samples in a second, where no column contains the time.
    """

    column: str | int | None = None
    format: str = ""
    rate_hz: Annotated[float, Bounds(above=0)] | None = None

    def __post_init__(self) -> None:
        """Check that the time is stated once."""
        if self.column is not None and self.rate_hz is not None:
            raise InputError("time: give either column or rate_hz")


Clock = Literal["stamp", "received"]
"""Whose time a message has: its header's stamp, or the recorder's when it arrived."""


class ChannelMap(Document):
    """The sensors of an array, sensor 1 first, and the channels recorded with them.

    Parameters
    ----------
    sensors : list of Pick
        Where the vectors of each sensor come from.
    further : mapping of str to Pick
        Further currents and actuators by the names of their columns, such as ``current_2_A``.
    scalar, attitude, gyroscope, temperature, current, position : Pick, optional
        The same of the channels.
    time : {"stamp", "received"} or TimeColumn
        Clock of the messages, or where a text file has its time.
    text : TextFormat
        How text files are written.
    """

    sensors: list[Pick]
    scalar: Pick | None = None
    attitude: Pick | None = None
    gyroscope: Pick | None = None
    temperature: Pick | None = None
    current: Pick | None = None
    position: Pick | None = None
    further: dict[str, Pick] = default_of(default_factory=dict)
    time: Clock | TimeColumn = "stamp"
    text: TextFormat = default_of(default_factory=TextFormat)

    def __post_init__(self) -> None:
        """Check the number of sensors."""
        require_sensor_count(len(self.sensors))
        require_further(self.further)
        if not self.sensors:
            raise InputError("sensors: name at least one")

    @property
    def streams(self) -> dict[str, Pick]:
        """What is read, by stream: ``tam_1`` to ``tam_K``, then the channels."""
        sensors = {sensor_stream(number): pick for number, pick in enumerate(self.sensors, start=1)}
        channels = {name: getattr(self, name) for name in CHANNEL_WIDTHS}
        return sensors | {name: pick for name, pick in channels.items() if pick is not None} | self.further

    @property
    def clock(self) -> Clock:
        """Whose time the messages have."""
        return "stamp" if isinstance(self.time, TimeColumn) else self.time

    @property
    def time_column(self) -> TimeColumn:
        """Where a text file has its time."""
        return self.time if isinstance(self.time, TimeColumn) else TimeColumn()

    @property
    def files(self) -> list[str]:
        """The files that it names, each once, in their order."""
        return list(dict.fromkeys(pick.file for pick in self.streams.values() if pick.file))

    def __str__(self) -> str:
        """Return what is taken for what, in one line."""
        taken = "; ".join(
            f"sensor {stream[4:]}: {pick}" if stream[:4] == "tam_" else f"{stream}: {pick}"
            for stream, pick in self.streams.items()
        )
        return f"{taken}{_time_in_words(self.time)}"


def _time_in_words(time: Clock | TimeColumn) -> str:
    if isinstance(time, TimeColumn):
        if time.rate_hz is not None:
            return f", {time.rate_hz:g} samples a second"
        return "" if time.column is None else f", time {time.column}{f' [{time.format}]' if time.format else ''}"
    return ", the recorder's times" if time == "received" else ""


def map_of(content: Mapping[str, Any]) -> ChannelMap:
    """Return the map that a mapping contains, as its file does.

    Raises
    ------
    InputError
        When a key is not known, or a value is no such thing.
    """
    return check(content, ChannelMap)


def read_map(path: str | Path) -> ChannelMap:
    """Read a map.

    Parameters
    ----------
    path : str or Path
        The YAML file; files that it names lie next to the recording.

    Raises
    ------
    InputError
        When it cannot be read, a key is not known, or a value is no such thing.
    """
    with mapping_in(Path(path)) as content, in_file(path):
        return map_of(content)


def map_to_mapping(channel_map: ChannelMap) -> dict[str, Any]:
    """Return the keys and values of a map's file, without what is as by default."""
    return dict(_stated(channel_map))


def _stated(value: Any) -> Any:
    """Return a value as a file has it: of a dataclass the keys and values that are not its defaults."""
    if isinstance(value, list):
        return [_stated(each) for each in value]
    if isinstance(value, dict):
        return {name: _stated(each) for name, each in value.items()}
    if not is_dataclass(value):
        return value
    made = {each.name: each.default_factory() for each in fields(value) if each.default_factory is not MISSING}
    defaults = {each.name: each.default for each in fields(value)} | made
    return {name: _stated(each) for name, each in vars(value).items() if each != defaults[name]}
