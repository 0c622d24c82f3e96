"""Which tables and fields of a recording are an array's sensors and channels, told by types, names and their number."""

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import cast

from tam_calibration.messages.missing import in_words
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.messages.topics import (
    IMU,
    MAGNETIC_FIELD,
    TEMPERATURE,
)
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT
from tam_calibration.recordings.channel_map import CHANNEL_WIDTHS, ChannelMap, Clock, FieldUnit, Pick
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.navigation import POSITION_FIELDS
from tam_calibration.recordings.own_names import own_columns, own_map, unread
from tam_calibration.recordings.tables import Source, Table, Wanted

_AXES = ("x", "y", "z")
_MAGNETIC = re.compile(
    r"mag(?!net|n?it)|magn(?!it)|field|flux|compass|tam|tesla|(^|[^a-z])b[_ ]?\d*[*]|(^|[^a-z])[hb]\d*_?[*]", re.I
)
"""Names of what reads a magnetic field; ``*`` stands for the axis."""

_OTHER = re.compile(
    r"acc|gyr|omega|angular|vel|lin|pos|euler|grav|rot|cov|bias|off?s|scale|std|var|^mo[*]|delta|rate", re.I
)
"""Names of vectors that are none, or are no readings."""

_PROCESSED = re.compile(r"filt|smooth|correct|(?<!un)calib|estimat|innov|observ|status", re.I)
_RAW = re.compile(r"raw|uncal|sensor_mag", re.I)
"""Names of readings that were changed after they were made, and of such as were not."""

_SCALAR = re.compile(
    r"scalar|intensity|gesamt|overhauser|total|proton|potassium|ca?esium|absolute|(^|[^a-z])[f](?=$|[^a-z])|(^|[^a-z])b(tot|abs)",
    re.I,
)
"""Names of a scalar magnetometer's readings."""

_UNIT = re.compile(r"[\s_\[(]+(nT|uT|µT|μT|mT|T|mG|G|gauss|mgauss)[\])]?$")
_UNIT_NAMES = {"µT": "uT", "μT": "uT", "gauss": "G", "mgauss": "mG"}
_CURRENT = re.compile(r"(^|[^a-z])curr(ent)?(?=$|[^a-z])", re.I)
_TEMPERATURE = re.compile(r"temp", re.I)
_RATE = re.compile(r"gyr|omega|angular_?vel|(^|[^a-z])w_?[*]", re.I)
_NO_RATE = re.compile(r"cov|bias|off?s|scale|deriv|delta|integral|acc", re.I)
"""Names of angular velocities, and of vectors in their tables that are none."""

_OF_ARDUPILOT = [("Q1", "Q2", "Q3", "Q4")]
_QUATERNIONS = {"vehicle_attitude": [("q[0]", "q[1]", "q[2]", "q[3]")], **dict.fromkeys(("XKQ", "NKQ1"), _OF_ARDUPILOT)}
"""Attitudes of PX4 and ArduPilot: from the body to north-east-down, the real part first."""

_NUMBER = re.compile(r"\d+")


@dataclass(frozen=True)
class Vector:
    """Three fields of a table that are the components of a vector, or four of a quaternion."""

    table: Table
    pattern: str
    fields: tuple[str, ...]

    @property
    def place(self) -> tuple[list[str | int], int, list[str | int]]:
        """Table, instance and field, by whose numbers vectors are put in order."""
        return _parts(self.table.name), self.table.instance, _parts(self.pattern)

    @property
    def changes(self) -> int:
        """How far its readings are from those that were made, by its names: 0 raw, 1 not said, 2 processed."""
        named = f"{self.table.name} {self.pattern}"
        return 0 if _RAW.search(named) else 2 if _PROCESSED.search(named) else 1

    @property
    def pick(self) -> Pick:
        """The pick that means it, with the unit that its names or its format state."""
        unit = unit_in(self.table, self.fields[0])
        if self.table.is_text:
            return Pick(columns=[_number_or_name(name) for name in self.fields], file=self.table.file, unit=unit)
        whole, _, last = self.pattern.rpartition(".")
        plain = {} if last == "*" and not whole else {"field": whole} if last == "*" else {"fields": list(self.fields)}
        is_own = self.table.type in (MAGNETIC_FIELD, IMU) and plain.get("field") in ("magnetic_field", "orientation")
        stated = "" if is_own else unit
        return Pick(topic=self.table.name, instance=self.table.instance, unit=stated, **({} if is_own else plain))


def _parts(name: str) -> list[str | int]:
    """Return the text between the numbers of a name, and the numbers."""
    return [int(part) if part.isdigit() else part for part in re.split(r"(\d+)", name)]


def _number_or_name(column: str) -> str | int:
    """Return a column as a map names it: by its number where it has no name."""
    return int(column) if column.isdigit() else column


@dataclass(frozen=True)
class Choice:
    """What would be taken of a recording.

    Parameters
    ----------
    channel_map : ChannelMap or None
        What would be taken; None where there is no sensor.
    doubts : tuple of str
        Why the choice is not certain, or not enough, each with what to add; empty where it can be made.
    remarks : tuple of str
        What was not taken although it may be meant.
    is_own : bool
        Whether its names are those of this package, so that units are as stated.
    """

    channel_map: ChannelMap | None
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    is_own: bool = False


def unit_in(table: Table, field: str) -> FieldUnit:
    """Return the unit of a field that the format or its name states; empty where neither does."""
    match = _UNIT.search(field)
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
    for path, count in _lists(table.fields).items():
        for first in range(0, count - 2 if count % 3 < 2 else 0, 3):
            places = tuple(f"{path}[{first + axis}]" for axis in range(3))
            vectors.append(Vector(table, f"{path}[{first}..]" if count > 3 else f"{path}.*", places))
    return vectors


def _lists(fields: Iterable[str]) -> dict[str, int]:
    """Return the number of places of each list."""
    counts: dict[str, int] = defaultdict(int)
    for field in fields:
        if match := re.fullmatch(r"(.*)\[\d+\]", field):
            counts[match[1]] += 1
    return counts


def choose(source: Source, sensor_count: int | None, frame_ids: Sequence[str] | None = None) -> Choice:
    """Return what would be taken of a recording.

    Parameters
    ----------
    source : Source
        An open recording.
    sensor_count : int, optional
        Number of sensors of the array, where it is known.
    frame_ids : sequence of str, optional
        Frames of the sensors' messages in the order of the sensors, where the array states them.

    Raises
    ------
    InputError
        When the names are those of this package, and a sensor or a column is missing.
    """
    own = own_map(source.tables, sensor_count) or own_columns(source.tables)
    if own is not None:
        left = [name for name in unread(source.tables) if name != getattr(source, "time_column", None)]
        return Choice(own, remarks=(f"not read: {', '.join(left)}",) if left else (), is_own=True)
    vectors = [vector for table in source.tables for vector in vectors_in(table)]
    others = [vector for vector in vectors if not _is_scalar(vector)]
    magnetic = [vector for vector in others if is_magnetic(vector)]
    of_frame = [[each for each in magnetic if each.table.frames == (frame,)] for frame in frame_ids or ()]
    sensors = [each[0] for each in of_frame] if all(len(each) == 1 for each in of_frame) else []
    doubts: tuple[str, ...] = ()
    if not sensors:
        sensors, doubts = _rawest(magnetic, sensor_count)
    if not sensors:
        sensors, doubts = _unnamed(source.tables, others, sensor_count)
    channels, remarks = _channels(source.tables, _scalars(source.tables, vectors, sensors), sensors)
    processed = [str(vector.pick) for vector in magnetic if sensors and vector.changes > sensors[0].changes]
    if processed:
        remarks = (
            f"not taken, as the sensors' readings are closer to what was measured: {_shortened(processed, most=4)}",
            *remarks,
        )
    if not sensors:
        held = _shortened([_described(table) for table in source.tables]) if source.tables else "nothing"
        return Choice(None, (f"no vector of a magnetic field is recognised among {held}",), remarks)
    return Choice(ChannelMap.of([each.pick for each in sensors], channels), doubts, remarks)


def _unnamed(
    tables: Sequence[Table], vectors: Sequence[Vector], sensor_count: int | None
) -> tuple[list[Vector], tuple[str, ...]]:
    """Return vectors that no name or type marks as a magnetic field, and why that is not certain.

    They are taken where their number is that of the sensors; without an array that number is not known, and names in a
    log, which are those of its format, are believed.
    """
    in_columns = [vector for table in tables for vector in _in_columns(table, sensor_count or len(table.fields) // 3)]
    free = [each for each in vectors if sensor_count or each.table.is_text or each.table.type]
    others = [vector for vector in free if not is_bookkeeping(vector.pattern) and not _OTHER.search(vector.pattern)]
    for guessed in (_lists_of(vectors, sensor_count), in_columns, others):
        if guessed and sensor_count in (None, len(guessed)):
            doubt = (
                "no name or type says which numbers are readings of a field: name the sensors in a map, or give --array"
            )
            return _in_order(guessed), () if sensor_count else (doubt,)
    return [], ()


def is_magnetic(vector: Vector) -> bool:
    """Whether a vector is a magnetic field by the type of its messages, or by its name."""
    if vector.table.type == MAGNETIC_FIELD:
        return vector.pattern == "magnetic_field.*"
    named = f"{vector.pattern} {'' if vector.table.is_text else vector.table.name}"
    return _OTHER.search(vector.pattern) is None and _MAGNETIC.search(named) is not None


def _is_scalar(vector: Vector) -> bool:
    return _SCALAR.search("" if vector.table.is_text else vector.table.name) is not None


def _in_columns(table: Table, sensor_count: int) -> list[Vector]:
    """Return the vectors of columns without names that are three for each sensor, and at most one more."""
    numbered = tuple(str(number) for number in range(1, len(table.columns) + 1))
    if (
        not table.is_text
        or table.columns != numbered
        or len(table.fields) not in (3 * sensor_count, 3 * sensor_count + 1)
    ):
        return []
    return [
        Vector(table, f"{first // 3:03d}", table.fields[first : first + 3]) for first in range(0, 3 * sensor_count, 3)
    ]


def _lists_of(vectors: Sequence[Vector], sensor_count: int | None) -> list[Vector]:
    """Return the vectors of lists that have three numbers for each sensor, and at most one more."""
    found = []
    for vector in vectors:
        if vector.pattern.endswith("..]") and not _OTHER.search(vector.pattern):
            count = _lists(vector.table.fields)[vector.pattern.rpartition("[")[0]]
            if count - 3 * (sensor_count or count // 3) in (0, 1):
                found.append(vector)
    return found


def _rawest(magnetic: Sequence[Vector], sensor_count: int | None) -> tuple[list[Vector], tuple[str, ...]]:
    """Return the sensors among vectors that were processed least; among others, where only these are the array's."""
    alike = [[each for each in magnetic if each.changes == changes] for changes in range(3)]
    found = [_sensors(each, sensor_count) for each in alike if each] or [([], ())]
    certain = [each for each in found if not each[1]] if sensor_count else []
    return (certain or found)[0]


def _sensors(magnetic: Sequence[Vector], sensor_count: int | None) -> tuple[list[Vector], tuple[str, ...]]:
    """Return the vectors that are the sensors, in their order, and why that is not certain."""
    groups: dict[tuple[str, str], list[Vector]] = defaultdict(list)
    for vector in magnetic:
        groups[vector.table.type, _NUMBER.sub("", f"{vector.table.name} {vector.pattern}")].append(vector)
    found = sorted(groups.values(), key=lambda group: -len(group))
    if sensor_count is not None:
        fitting = [group for group in found if len(group) == sensor_count]
        if not fitting and len(magnetic) == sensor_count:
            fitting = [list(magnetic)]
    else:
        fitting = [group for group in found if len(group) == len(found[0])]
        if len(fitting) > 1 and len(found[0]) == 1 and len({vector.table.type for vector in magnetic}) == 1:
            fitting = [list(magnetic)]
    named = ", ".join(sorted(str(vector.pick) for vector in magnetic))
    if len(fitting) == 1:
        return _in_order(fitting[0]), ()
    if len(fitting) > 1:
        return _in_order(fitting[0]), (f"several sets of sensors may be meant ({named}): name one in the map",)
    if not magnetic:
        return [], ()
    doubt = f"{len(magnetic)} magnetic vectors are there ({named}), and the array has {sensor_count} sensors"
    return _in_order(found[0])[:sensor_count], (f"{doubt}: name the sensors in the map",)


def _in_order(vectors: Sequence[Vector]) -> list[Vector]:
    """Return vectors by the numbers in their names, else by the alphabet."""
    return sorted(vectors, key=lambda vector: vector.place)


def _scalars(tables: Sequence[Table], vectors: Sequence[Vector], sensors: Sequence[Vector]) -> list[Pick]:
    """Return what may be the readings of a scalar magnetometer; of topics what stands beside a magnetic field."""
    beside = {vector.table.key for vector in sensors}
    of_vectors = {field for vector in vectors for field in vector.fields}
    picks = [vector.pick for vector in vectors if is_magnetic(vector) and _is_scalar(vector)]
    for table in tables:
        single = [field for field in table.fields if field not in of_vectors and not is_bookkeeping(field)]
        is_named = len(single) == 1 and _SCALAR.search(table.name) is not None
        for field in single:
            unit = unit_in(table, field)
            is_beside = table.is_text or table.key in beside
            is_of_field = is_beside or unit or _MAGNETIC.search(f"{field} {table.name}")
            if (
                is_named
                or (is_of_field and _SCALAR.search(_UNIT.sub("", field)))
                or (is_beside and _is_last(table, field))
            ):
                picks.append(_single(table, field, unit))
    return picks


def _is_last(table: Table, field: str) -> bool:
    """Whether a place of a list, or a column without a name, is one more than vectors need."""
    path = field.rpartition("[")[0]
    same = [name for name in table.fields if name.rpartition("[")[0] == path] if path else list(table.fields)
    is_unnamed = field.isdigit() or path != ""
    return is_unnamed and len(same) > 3 and len(same) % 3 == 1 and field == same[-1]


def is_bookkeeping(field: str) -> bool:
    """Whether a field describes the readings, and is none."""
    return field.startswith(("header.", "layout.", "stamp.")) or "covariance" in field


def _single(table: Table, field: str, unit: FieldUnit = "") -> Pick:
    if table.is_text:
        return Pick(column=_number_or_name(field), file=table.file, unit=unit)
    return Pick(topic=table.name, instance=table.instance, field=field, unit=unit)


def _channels(
    tables: Sequence[Table], scalars: list[Pick], sensors: Sequence[Vector]
) -> tuple[dict[str, Pick], tuple[str, ...]]:
    """Return the channels recorded with the sensors, and what was not taken because there are several."""
    attitudes = [pick for table in tables for pick in attitudes_in(table)]
    rates = [vector.pick for table in tables for vector in vectors_in(table) if _is_rate(vector)]
    temperatures, currents = [], []
    for table in tables:
        if table.type == TEMPERATURE:
            temperatures.append(Pick(topic=table.name))
            continue
        single = [field for field in table.fields if not is_bookkeeping(field) and "[" not in field]
        for field in single:
            named = field if table.is_text or len(single) > 1 else f"{table.name} {field}"
            if _TEMPERATURE.search(named):
                temperatures.append(_single(table, field))
            elif _CURRENT.search(named.rpartition(".")[2]):
                currents.append(_single(table, field))
    channels, remarks = {}, []
    found = {
        "scalar": scalars,
        "attitude": attitudes,
        "gyroscope": rates,
        "temperature": temperatures,
        "current": currents,
    }
    for name, picks in found.items():
        own = [pick for pick in picks if pick.table in {vector.table.key for vector in sensors}]
        taken = picks if len(picks) == 1 else own if len(own) == 1 else []
        if taken:
            channels[name] = taken[0]
        elif picks:
            remarks.append(
                f"{in_words(name)} may be {_shortened(list(map(str, picks)), ' or ', 4)}: name one in the map"
            )
    return channels, tuple(remarks)


def _is_rate(vector: Vector) -> bool:
    named = vector.pattern if vector.table.is_text or "." in vector.pattern else f"{vector.pattern} {vector.table.name}"
    return _RATE.search(named) is not None and not _NO_RATE.search(vector.pattern)


def reason(stream: str, wanted: Wanted) -> str:
    """Return what a choice was made by: the type of the messages, a name, or the place among other numbers."""
    table, fields = wanted
    if table.type in (MAGNETIC_FIELD, IMU, TEMPERATURE):
        return f"type {table.type.rpartition('/')[2]}"
    named = [vector for vector in vectors_in(table) if vector.fields == fields and is_magnetic(vector)]
    is_placed = not named if stream.startswith("tam_") else stream == "scalar" and _is_last(table, fields[0])
    return "place" if is_placed else "name"


def attitudes_in(table: Table) -> list[Pick]:
    """Return the quaternions of a table."""
    names, picks = set(table.fields), []
    if table.type == IMU:
        return [Pick(topic=table.name, field="orientation")]
    for real, *imaginary in _QUATERNIONS.get(table.name, ()):
        if {real, *imaginary} <= names:
            picks.append(Pick(topic=table.name, instance=table.instance, fields=[*imaginary, real], world="ned"))
    for field in table.fields:
        for match in re.finditer("w", field, re.I):
            same = [
                f"{field[: match.start()]}{letter}{field[match.end() :]}"
                for letter in ("xyz" if match[0] == "w" else "XYZ")
            ]
            if set(same) <= names and not is_bookkeeping(field):
                picks.append(
                    Pick(columns=[*same, field], file=table.file)
                    if table.is_text
                    else Pick(topic=table.name, instance=table.instance, fields=[*same, field])
                )
    return picks


def resolve(source: Source, channel_map: ChannelMap, has_sure_units: bool = True) -> Streams:
    """Return the tables and fields that a map means.

    Parameters
    ----------
    source : Source
        An open recording.
    channel_map : ChannelMap
        What is taken.
    has_sure_units : bool
        Whether units that only the format states are certain; else the size of the field may tell another.

    Raises
    ------
    InputError
        When one is not there, or has another type.
    """
    tables = {table.key: table for table in source.tables}
    wanted = {stream: wanted_of(tables, stream, pick) for stream, pick in channel_map.streams.items()}
    stated = {stream: unit_in(each.table, each.fields[0]) for stream, each in wanted.items()}
    picks = channel_map.streams
    if has_sure_units:
        picks = {
            stream: replace(pick, unit=stated[stream]) if pick.factor is None else pick
            for stream, pick in picks.items()
        }
    clock: Clock = channel_map.clock
    is_stamped = all(wanted[sensor_stream(number + 1)].table.is_stamped for number in range(len(channel_map.sensors)))
    return Streams(wanted, picks, clock if is_stamped else "received", {} if has_sure_units else stated)


def wanted_of(tables: Mapping[tuple[str, int], Table], stream: str, pick: Pick) -> Wanted:
    """Return the fields that a pick means.

    Parameters
    ----------
    tables : mapping of (str, int) to Table
        By name and instance.
    stream : str
        What is read.
    pick : Pick
        From where.

    Raises
    ------
    InputError
        When a field is not there, or has another type.
    """
    table = _table(tables, pick)
    return Wanted(table, _fields(stream, table, pick))


def _table(tables: Mapping[tuple[str, int], Table], pick: Pick) -> Table:
    """Return the table of a pick: by its name, with or without the leading slash; the only one where it has none."""
    name, instance = pick.table
    if not name and len(tables) == 1:
        return next(iter(tables.values()))
    for each in (name, f"/{name}", name.removeprefix("/")):
        if (each, instance) in tables:
            return tables[each, instance]
    kind = "file" if pick.file or not name else "topic"
    held = ", ".join(sorted(table.title for table in tables.values())) or "none"
    missing = f"{kind} {name}{f' [{instance}]' if instance else ''} is missing" if name else "a map names no file"
    raise InputError(f"{missing}; the recording has {held}")


def _fields(stream: str, table: Table, pick: Pick) -> tuple[str, ...]:
    """Return the fields that a pick names, or that the type of the messages suggests.

    Raises
    ------
    InputError
        When they are not there, or their number is wrong.
    """
    width = CHANNEL_WIDTHS.get(stream, 1) if not stream.startswith("tam_") else 3
    widths = (1, 3) if stream == "scalar" else (width,)
    paths = pick.paths
    if len(paths) == 1 and not isinstance(paths[0], int) and paths[0] not in table.fields:
        found = _below(paths[0], table, widths)
    elif paths:
        found = tuple(_column(path, table) for path in paths)
    else:
        found = _suggested(stream, table, widths)
    if len(found) not in widths:
        needed = " or ".join(map(str, widths))
        raise InputError(
            f"{in_words(stream)} needs {needed} numbers of {table.title}, and the map names {len(found)}: "
            f"it has {_shortened(table.fields)}"
        )
    return found


def _below(path: str, table: Table, widths: Sequence[int]) -> tuple[str, ...]:
    """Return the components of a vector, a quaternion or a short list at a path."""
    for names in ("xyzw", "xyz", "XYZ"):
        below = tuple(f"{path}.{name}" for name in names)
        if len(below) in widths and set(below) <= set(table.fields):
            return below
    for width in widths:
        places = tuple(f"{path}[{index}]" for index in range(width))
        if set(places) <= set(table.fields) and f"{path}[{width}]" not in table.fields:
            return places
    raise InputError(f"{table.title} has no {path}: it has {_shortened(table.fields)}")


def _column(path: str | int, table: Table) -> str:
    if isinstance(path, int):
        if not 1 <= path <= len(table.columns):
            raise InputError(f"{table.title} has {len(table.columns)} columns, none with the number {path}")
        return table.columns[path - 1]
    if path not in table.fields:
        raise InputError(f"{table.title} has no {quoted(path)}: it has {_shortened(table.fields)}")
    return path


def _suggested(stream: str, table: Table, widths: Sequence[int]) -> tuple[str, ...]:
    """Return the fields of a stream that a type or names suggest."""
    if stream == "position" and table.type in POSITION_FIELDS:
        return POSITION_FIELDS[table.type]
    if stream == "gyroscope" and table.type == IMU:
        return _below("angular_velocity", table, widths)
    if stream == "attitude":
        for pick in attitudes_in(table):
            return tuple(map(str, pick.fields or pick.columns)) or _below(pick.field, table, widths)
    single = tuple(field for field in table.fields if not is_bookkeeping(field) and field != "variance")
    if 1 in widths and len(single) == 1:
        return single
    vectors = [vector for vector in vectors_in(table) if not is_bookkeeping(vector.pattern)]
    magnetic = [vector for vector in vectors if is_magnetic(vector)]
    for found in (vectors, magnetic):
        if 3 in widths and len(found) == 1:
            return found[0].fields
    named = {"temperature": _TEMPERATURE, "current": _CURRENT, "scalar": _SCALAR}.get(stream)
    fitting = [field for field in single if named and named.search(field)]
    if 1 in widths and len(fitting) == 1:
        return tuple(fitting)
    kind = f"has the type {table.type}" if table.type else "is a table"
    raise InputError(
        f"{table.title} {kind}, and the map does not say which of its fields is {in_words(stream)}: "
        f"it has {_shortened(table.fields)}"
    )


def _shortened(names: Sequence[str], between: str = ", ", most: int = 12) -> str:
    listed = between.join(names[:most])
    return f"{listed} and {len(names) - most} more" if len(names) > most else listed or "no numbers"


def _described(table: Table) -> str:
    if table.type:
        return f"{table.title} ({table.type})"
    return f"{table.title} ({_shortened(table.fields)})" if table.title else f"columns {_shortened(table.fields)}"
