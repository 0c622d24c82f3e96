"""Meaning of the fields of a table by types and names: vectors, quaternions, units, and this package's own columns."""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any, cast

from tam_calibration.messages.point_cloud import CHANNEL_COLUMNS, CHANNEL_TOPICS, IMU, MAGNETIC_FIELD, sensor_topic
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import (
    POSITION_COLUMNS,
    is_further,
    named_by,
    require_further,
    require_sensor_count,
)
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT
from tam_calibration.recordings.channel_map import ChannelMap, FieldUnit, Pick, World
from tam_calibration.recordings.intake import GEOGRAPHIC_COLUMNS
from tam_calibration.recordings.tables import Table

_AXES = ("x", "y", "z")
MAGNETIC = re.compile(
    r"mag(?!net|n?it)|magn(?!it)|field|flux|compass|tam|tesla|(^|[^a-z])b[_ ]?\d*[*]|(^|[^a-z])[hb]\d*_?[*]", re.I
)
"""Names of what reads a magnetic field; ``*`` stands for the axis."""

OTHER = re.compile(
    r"acc|gyr|omega|angular|vel|lin|pos|euler|grav|rot|cov|bias|off?s|scale|std|var|^mo[*]|delta|rate", re.I
)
"""Names of vectors that are none, or are no readings."""

_PROCESSED = re.compile(r"filt|smooth|correct|(?<!un)calib|estimat|innov|observ|status", re.I)
_RAW = re.compile(r"raw|uncal|sensor_mag", re.I)
"""Names of readings that were changed after they were made, and of such as were not."""

UNIT_SUFFIX = re.compile(r"[\s_\[(]+(nT|uT|µT|μT|mT|T|mG|G|gauss|mgauss)[\])]?$")
_UNIT_NAMES = {"µT": "uT", "μT": "uT", "gauss": "G", "mgauss": "mG"}
_RATE = re.compile(r"gyr|omega|angular_?vel|(^|[^a-z])w_?[*]", re.I)
_NO_RATE = re.compile(r"cov|bias|off?s|scale|deriv|delta|integral|acc", re.I)
"""Names of angular velocities, and of vectors in their tables that are none."""

_OF_ARDUPILOT = ("Q1", "Q2", "Q3", "Q4")
_QUATERNIONS = {"vehicle_attitude": ("q[0]", "q[1]", "q[2]", "q[3]"), "XKQ": _OF_ARDUPILOT, "NKQ1": _OF_ARDUPILOT}
"""Attitudes of PX4 and ArduPilot: from the body to north-east-down, the real part first."""


@dataclass(frozen=True)
class Vector:
    """Three fields of a table that are the components of a vector, or four of a quaternion."""

    table: Table
    pattern: str
    fields: tuple[str, ...]

    @property
    def place(self) -> tuple[list[str | int], int, list[str | int]]:
        """Table, instance and field, by whose numbers vectors are sorted."""
        return _parts(self.table.name), self.table.instance, _parts(self.pattern)

    @property
    def changes(self) -> int:
        """How much its readings were processed, by its names: 0 raw, 1 not stated, 2 processed."""
        named = f"{self.table.name} {self.pattern}"
        return 0 if _RAW.search(named) else 2 if _PROCESSED.search(named) else 1

    @property
    def pick(self) -> Pick:
        """The pick that means it, with the unit that its names or its format state."""
        if self.table.type == MAGNETIC_FIELD and self.pattern == "magnetic_field.*":
            return pick_of(self.table)
        path, _, last = self.pattern.rpartition(".")
        fields = self.fields if self.table.is_text or last != "*" else (path,)
        return pick_of(self.table, *fields, unit=unit_in(self.table, self.fields[0]))


def _parts(name: str) -> list[str | int]:
    """Return the text between the numbers of a name, and the numbers."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]


def pick_of(table: Table, *fields: str, unit: FieldUnit = "", world: World = "enu") -> Pick:
    """Return the pick that means some fields of a table; without any it is the table, whose type names them."""
    if table.is_text:
        columns = [int(name) if name.isdigit() else name for name in fields]  # a column without a name has its number
        named: dict[str, Any] = {"column": columns[0]} if len(fields) == 1 else {"columns": columns}
        return Pick(file=table.name, unit=unit, world=world, **named)
    named = {"field": fields[0]} if len(fields) == 1 else {"fields": list(fields)}
    return Pick(topic=table.name, instance=table.instance, unit=unit, world=world, **named)


def unit_in(table: Table, field: str) -> FieldUnit:
    """Return the unit of a field that the format or its name states; empty where neither does."""
    match = UNIT_SUFFIX.search(field)
    stated = table.units.get(field) or (match[1] if match else "")
    unit = _UNIT_NAMES.get(stated, stated)
    return cast(FieldUnit, unit) if unit in TESLA_PER_FIELD_UNIT else ""


def vectors_in(table: Table) -> list[Vector]:
    """Return the vectors of a table: names that differ in x, y and z alone, or three places of a short list."""
    by_pattern: dict[str, dict[str, str]] = defaultdict(dict)
    for field in table.fields:
        for match in re.finditer("[xyz]", field, re.I):
            by_pattern[f"{field[: match.start()]}*{field[match.end() :]}"][match[0].lower()] = field
    names = set(table.fields)
    vectors = []
    for pattern, fields in by_pattern.items():
        is_quaternion = any(pattern.replace("*", letter) in names for letter in "wW")
        if len(fields) == 3 and not is_quaternion:
            vectors.append(Vector(table, pattern, tuple(fields[axis] for axis in _AXES)))
    for path, count in lists_in(table.fields).items():
        for first in range(0, count - 2 if count % 3 < 2 else 0, 3):
            places = tuple(f"{path}[{first + axis}]" for axis in range(3))
            vectors.append(Vector(table, f"{path}[{first}..]" if count > 3 else f"{path}.*", places))
    return vectors


def lists_in(fields: Iterable[str]) -> dict[str, int]:
    """Return the number of elements of each list among some fields."""
    counts: dict[str, int] = defaultdict(int)
    for field in fields:
        if match := re.fullmatch(r"(.*)\[\d+\]", field):
            counts[match[1]] += 1
    return counts


def is_magnetic(vector: Vector) -> bool:
    """Whether a vector is a magnetic field by the type of its messages, or by its name."""
    if vector.table.type == MAGNETIC_FIELD:
        return vector.pattern == "magnetic_field.*"
    named = f"{vector.pattern} {'' if vector.table.is_text else vector.table.name}"
    return OTHER.search(vector.pattern) is None and MAGNETIC.search(named) is not None


def is_rate(vector: Vector) -> bool:
    """Return whether a vector is an angular velocity by its name."""
    named = vector.pattern if vector.table.is_text or "." in vector.pattern else f"{vector.pattern} {vector.table.name}"
    return _RATE.search(named) is not None and not _NO_RATE.search(vector.pattern)


def attitudes_in(table: Table) -> list[Pick]:
    """Return the quaternions of a table."""
    names, picks = set(table.fields), []
    if table.type == IMU:
        return [pick_of(table, "orientation")]
    if (known := _QUATERNIONS.get(table.name)) and set(known) <= names:
        picks.append(pick_of(table, *known[1:], known[0], world="ned"))
    for field in table.fields:
        for match in re.finditer("w", field, re.I):
            letters = "xyz" if match[0] == "w" else "XYZ"
            same = [f"{field[: match.start()]}{letter}{field[match.end() :]}" for letter in letters]
            if set(same) <= names and not is_bookkeeping(field):
                picks.append(pick_of(table, *same, field))
    return picks


def is_bookkeeping(field: str) -> bool:
    """Whether a field describes the readings, and is none."""
    return field.startswith(("header.", "layout.", "stamp.")) or "covariance" in field


def shortened(names: Sequence[str], between: str = ", ", most: int = 12) -> str:
    """Return the first of some names, and how many more there are."""
    listed = between.join(names[:most])
    return f"{listed} and {len(names) - most} more" if len(names) > most else listed or "no numbers"


_OWN_FIELD = re.compile(rf"(b([1-9]\d{{,8}})[xyz]|scalar)_({'|'.join(TESLA_PER_FIELD_UNIT)})")
_OWN_COLUMNS = [(channel, columns) for channel, columns in CHANNEL_COLUMNS.items() if channel != "scalar"]
_OWN_COLUMNS.append(("position", GEOGRAPHIC_COLUMNS))
"""Channels and their columns, but for the scalar, whose unit may be any."""


def is_own_column(name: str) -> bool:
    """Return whether a column has one of the names of ours."""
    known = ("time_s", *chain(*(columns for _, columns in _OWN_COLUMNS)))
    return name in known or is_further(name) or _OWN_FIELD.fullmatch(name) is not None


def own_columns(tables: Sequence[Table]) -> ChannelMap | None:
    """Return the map of columns that have the names of ours; None where none is that of a sensor.

    Raises
    ------
    InputError
        When a column is missing.
    """
    if len(tables) != 1 or not tables[0].is_text:
        return None
    fields = tables[0].fields
    matches = {match[1]: match for name in fields if (match := _OWN_FIELD.fullmatch(name))}
    numbers = [int(match[2]) for match in matches.values() if match[2]]
    if not numbers:
        return None
    require_sensor_count(max(numbers))
    sensors = []
    for number in range(1, max(numbers) + 1):
        names = [f"b{number}{axis}" for axis in "xyz"]
        if missing := [name for name in names if name not in matches]:
            raise InputError(f"column {missing[0]}_nT is missing (of {max(numbers)} sensors)")
        units = {matches[name][3] for name in names}
        if len(units) > 1:
            raise InputError(f"the columns of sensor {number} are in {' and '.join(sorted(units))}: give them one unit")
        sensors.append(Pick(columns=[matches[name][0] for name in names], unit=cast(FieldUnit, units.pop())))
    channels: dict[str, Any] = {}
    if scalar := matches.get("scalar"):
        channels["scalar"] = Pick(column=scalar[0], unit=cast(FieldUnit, scalar[3]))
    if set(POSITION_COLUMNS) & set(fields) and set(GEOGRAPHIC_COLUMNS) & set(fields):
        raise InputError("the position is there twice: keep x_m, y_m, z_m or lat_deg, lon_deg, depth_m")
    for channel, columns in _OWN_COLUMNS:
        if set(columns) & set(fields):
            if missing := [name for name in columns if name not in fields]:
                raise InputError(f"column {missing[0]} is missing (of {', '.join(columns)})")
            channels[channel] = pick_of(tables[0], *columns)
    further = {name: Pick(column=name) for name in require_further(filter(is_further, fields))}
    return ChannelMap(sensors=sensors, further=further, **channels)


def own_map(tables: Sequence[Table], sensor_count: int | None) -> ChannelMap | None:
    """Return the map of topics that have the names of ours; None where there is no topic of sensor 1.

    Raises
    ------
    InputError
        When there are several arrays, or a sensor is missing.
    """
    first, topics = sensor_topic(1), {table.name for table in tables if not table.is_text}
    spaces = sorted(topic.removesuffix(first) for topic in topics if f"/{topic}".endswith(f"/{first}"))
    if not spaces:
        return None
    if len(spaces) > 1:
        raise InputError(f"the bag has several arrays, under {', '.join(spaces)}: name the topics of one in a map")
    space = spaces[0]
    pattern = re.compile(re.escape(space) + sensor_topic(0).replace("0", r"(\d{1,9})"))
    highest = max(int(match[1]) for topic in topics if (match := pattern.fullmatch(topic)))
    if sensor_count and highest > sensor_count:
        raise InputError(f"the bag has {highest} sensors, the array {sensor_count}: use the array file of this bag")
    sensors = [Pick(topic=space + sensor_topic(sensor)) for sensor in range(1, (sensor_count or highest) + 1)]
    channels: dict[str, Any] = {
        name: Pick(topic=space + topic) for name, topic in CHANNEL_TOPICS.items() if space + topic in topics
    }
    relative = {topic: named_by(topic.removeprefix(space)) for topic in sorted(topics) if topic.startswith(space)}
    further = {name: Pick(topic=topic) for topic, name in relative.items() if name}
    return ChannelMap(sensors=sensors, further=further, **channels)
