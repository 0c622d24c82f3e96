"""The map: which topics, fields or columns are an array's sensors and channels; which part of a recording is read."""

from collections.abc import Mapping
from dataclasses import MISSING, dataclass, fields, is_dataclass
from dataclasses import field as default_of
from datetime import datetime
from pathlib import Path
from re import fullmatch
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray

from tam_calibration.files.schema import Bounds, Document, check
from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.messages.point_cloud import columns_of
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.recording import require_further, require_sensor_count
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT, IntArray
from tam_calibration.recordings.times import nanoseconds_of

FieldUnit = Literal["", "T", "mT", "uT", "nT", "G", "mG"]
"""Unit of a field; empty where it is not stated."""

World = Literal["enu", "ned"]
"""Axes of the world of an attitude or a position."""

_CHANNELS = ("scalar", "attitude", "gyroscope", "temperature", "current", "position")
CHANNEL_WIDTHS = {name: len(columns_of(name)) for name in _CHANNELS}
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
    with mapping_in(Path(path)) as content:
        return map_of(content)


def as_map(given: "ChannelMap | Mapping[str, Any] | str | Path | None") -> ChannelMap | None:
    """Return a map, however it is given; None of nothing."""
    if given is None or isinstance(given, ChannelMap):
        return given
    return map_of(given) if isinstance(given, Mapping) else read_map(given)


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


@dataclass(frozen=True)
class Moment:
    """A time in a recording: from its start, or of day.

    Parameters
    ----------
    time_ns : int
        Nanoseconds from the start of the recording, or since 1970.
    is_absolute : bool
        Whether it is since 1970.
    """

    time_ns: int
    is_absolute: bool

    @classmethod
    def of(cls, words: str | float) -> "Moment":
        """Return what is meant by seconds from the start or an ISO 8601 time; one without a zone is UTC.

        Raises
        ------
        InputError
            When it is neither.
        """
        if isinstance(words, str) and not fullmatch(r"\s*[-+]?\d*\.?\d+(e[-+]?\d+)?\s*", words, flags=2):
            try:
                moment = datetime.fromisoformat(words)
            except ValueError:
                raise InputError(
                    f"{quoted(words)} is no time: give seconds from the start such as 12.5, or 2026-06-01T12:00:00"
                ) from None
            return cls(nanoseconds_of(moment), True)
        seconds = float(words)
        if not 0 <= seconds < 9e9:
            raise InputError(f"{seconds:g} s from the start is no time in a recording: give 0 or more")
        return cls(round(seconds * 1e9), False)

    def since_epoch(self, first_ns: int) -> int:
        """Return it on the clock of the stamps.

        Parameters
        ----------
        first_ns : int
            First stamp of the recording, nanoseconds.

        Raises
        ------
        InputError
            When it is of day, and the stamps are not.
        """
        if not self.is_absolute:
            return first_ns + self.time_ns
        # Stamps before March 1973 count from when something was switched on.
        if first_ns < 10**17:
            raise InputError("its times are no times of day: give --from and --until in seconds from the start")
        return self.time_ns


@dataclass(frozen=True)
class Window:
    """The part of a recording that is read: from one moment until another."""

    start: Moment | None = None
    end: Moment | None = None

    @classmethod
    def of(cls, start: str | float | None, until: str | float | None) -> "Window":
        """Return the part between two times, each as of `Moment`; None of a time sets no limit."""
        return cls(*(None if each is None else Moment.of(each) for each in (start, until)))

    def contains(self, stamps_ns: IntArray, first_ns: int) -> NDArray[np.bool_]:
        """Return which stamps (n,) lie within; the end belongs to it.

        Parameters
        ----------
        stamps_ns : (n,) array of int
            Nanoseconds.
        first_ns : int
            First stamp of the recording.
        """
        inside = np.ones(len(stamps_ns), dtype=bool)
        if self.start is not None:
            inside &= stamps_ns >= self.start.since_epoch(first_ns)
        if self.end is not None:
            inside &= stamps_ns <= self.end.since_epoch(first_ns)
        return inside


@dataclass(frozen=True)
class Reading:
    """How a recording is read.

    Parameters
    ----------
    channel_map : ChannelMap, optional
        Which topics or columns are what; without one the choice is made from what the recording contains.
    window : Window
        The part that is read.
    unwrap : bool
        Whether overflows of a sensor's counter are taken out.
    base_station : Path, optional
        IAGA-2002 file, from which the intensity is taken where the recording has none.
    tolerance_s : float
        Greatest difference of stamps within a sample, seconds.
    files : tuple of Path
        What was read for it, which no output may replace.
    origin : tuple of float, optional
        Latitude and longitude, degrees, and height, metres, from which geographic positions count; from their first
        where it is not given.
    sensor_count : int, optional
        Number of sensors that there must be, where no array says it.
    with_partial : bool
        Whether samples are kept that lack a sensor that was silent, or whose reading is missing.
    """

    channel_map: ChannelMap | None = None
    window: Window = default_of(default_factory=Window)
    unwrap: bool = False
    base_station: Path | None = None
    tolerance_s: float = 0.0
    files: tuple[Path, ...] = ()
    origin: tuple[float, float, float] | None = None
    sensor_count: int | None = None
    with_partial: bool = False


AS_IT_IS = Reading()
"""The complete recording, without a map."""
