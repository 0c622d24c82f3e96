"""The tables and fields that a map means, and the choice of them without a map: by types, names and numbers."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

from tam_calibration.messages.missing import in_words
from tam_calibration.messages.point_cloud import IMU, MAGNETIC_FIELD, TEMPERATURE
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.recordings import vectors
from tam_calibration.recordings.channel_map import CHANNEL_WIDTHS, ChannelMap, Pick
from tam_calibration.recordings.intake import POSITION_FIELDS
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.tables import Source, Table, Wanted
from tam_calibration.recordings.vectors import Vector, is_bookkeeping, is_magnetic, shortened, vectors_in

NAMES = {
    "scalar": re.compile(
        r"scalar|intensity|gesamt|overhauser|total|proton|potassium|ca?esium|absolute|\|[bfh]\|"
        r"|(^|[^a-z])(f|cs|tmi)(?=$|[^a-z])|(^|[^a-z])[bf](tot|abs)|(?-i:[a-z]F(?![A-Za-z]))",
        re.I,
    ),
    "temperature": re.compile(r"temp", re.I),
    "current": re.compile(r"(^|[^a-z])curr(ent)?(?=$|[^a-z])", re.I),
}
"""Names of channels of one number."""


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
    stated = {stream: vectors.unit_in(each.table, each.fields[0]) for stream, each in wanted.items()}
    picks = channel_map.streams
    if has_sure_units:
        without = {stream: pick for stream, pick in picks.items() if pick.factor is None}
        picks |= {stream: replace(pick, unit=stated[stream]) for stream, pick in without.items()}
    is_stamped = all(wanted[sensor_stream(number + 1)].table.is_stamped for number in range(len(channel_map.sensors)))
    return Streams(wanted, picks, channel_map.clock if is_stamped else "received", {} if has_sure_units else stated)


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
    width = 3 if stream.startswith("tam_") else CHANNEL_WIDTHS.get(stream, 1)
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
            f"it has {shortened(table.fields)}"
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
    raise InputError(f"{table.title} has no {path}: it has {shortened(table.fields)}")


def _column(path: str | int, table: Table) -> str:
    if isinstance(path, int):
        if not 1 <= path <= len(table.columns):
            raise InputError(f"{table.title} has {len(table.columns)} columns, none with the number {path}")
        return table.columns[path - 1]
    if path not in table.fields:
        raise InputError(f"{table.title} has no {quoted(path)}: it has {shortened(table.fields)}")
    return path


def _suggested(stream: str, table: Table, widths: Sequence[int]) -> tuple[str, ...]:
    """Return the fields of a stream that a type or names suggest."""
    if stream == "position" and table.type in POSITION_FIELDS:
        return POSITION_FIELDS[table.type]
    if stream == "gyroscope" and table.type == IMU:
        return _below("angular_velocity", table, widths)
    if stream == "attitude":
        for pick in vectors.attitudes_in(table):
            return tuple(map(str, pick.fields or pick.columns)) or _below(pick.field, table, widths)
    single = tuple(field for field in table.fields if not is_bookkeeping(field) and field != "variance")
    if 1 in widths and len(single) == 1:
        return single
    candidates = [vector for vector in vectors_in(table) if not is_bookkeeping(vector.pattern)]
    magnetic = [vector for vector in candidates if is_magnetic(vector)]
    for found in (candidates, magnetic):
        if 3 in widths and len(found) == 1:
            return found[0].fields
    fitting = [field for field in single if stream in NAMES and NAMES[stream].search(field)]
    if 1 in widths and len(fitting) == 1:
        return tuple(fitting)
    kind = f"has the type {table.type}" if table.type else "is a table"
    raise InputError(
        f"{table.title} {kind}, and the map does not say which of its fields is {in_words(stream)}: "
        f"it has {shortened(table.fields)}"
    )


_NUMBER = re.compile(r"\d+")


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
        What was not taken although it may be meant, and the order.
    order : str
        Why the order of the sensors is not certain; empty where numbers or frames tell it.
    is_own : bool
        Whether its names are those of this package, so that units are as stated.
    """

    channel_map: ChannelMap | None
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()
    order: str = ""
    is_own: bool = False


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
    own = vectors.own_map(source.tables, sensor_count) or vectors.own_columns(source.tables)
    if own is not None:
        columns = [name for table in source.tables for name in table.columns if not vectors.is_own_column(name)]
        left = [name for name in columns if name != getattr(source, "time_column", None)]
        return Choice(own, remarks=(f"not read: {', '.join(left)}",) if left else (), is_own=True)
    candidates = [vector for table in source.tables for vector in vectors_in(table)]
    others = [vector for vector in candidates if not _is_scalar(vector)]
    magnetic = [vector for vector in others if is_magnetic(vector)]
    of_frame = [[each for each in magnetic if each.table.frames == (frame,)] for frame in frame_ids or ()]
    sensors = [each[0] for each in of_frame] if all(len(each) == 1 for each in of_frame) else []
    doubt, is_framed = "", bool(sensors)
    if not sensors:
        sensors, doubt = _rawest(magnetic, sensor_count)
    if not sensors:
        sensors, doubt = _unnamed(source.tables, others, sensor_count)
    scalars, possible = _scalars(source.tables, candidates, sensors)
    channels, remarks = _channels(source.tables, scalars, sensors)
    if possible and not scalars:
        remarks = (*remarks, f"not taken, may be a scalar: {shortened(possible)}")
    order = "" if is_framed else _order_doubt(sensors)
    remarks = (order, *remarks) if order else remarks
    processed = [str(vector.pick) for vector in magnetic if sensors and vector.changes > sensors[0].changes]
    if processed:
        listed = shortened(processed, most=4)
        remarks = (f"not taken, as the sensors' readings are closer to what was measured: {listed}", *remarks)
    if not sensors:
        present = shortened([_described(table) for table in source.tables]) if source.tables else "nothing"
        return Choice(None, (f"no vector of a magnetic field is recognised among {present}",), remarks)
    chosen = ChannelMap(sensors=[each.pick for each in sensors], **channels)
    return Choice(chosen, (doubt,) if doubt else (), remarks, order)


def _unnamed(
    tables: Sequence[Table], candidates: Sequence[Vector], sensor_count: int | None
) -> tuple[list[Vector], str]:
    """Return vectors that no name or type marks as a magnetic field, and why that is not certain.

    They are taken where their number is that of the sensors; without an array that number is not known, and names in a
    log, which are those of its format, are believed.
    """
    in_columns = [vector for table in tables for vector in _in_columns(table, sensor_count or len(table.fields) // 3)]
    free = [each for each in candidates if sensor_count or each.table.is_text or each.table.type]
    others = [
        vector for vector in free if not is_bookkeeping(vector.pattern) and not vectors.OTHER.search(vector.pattern)
    ]
    for guessed in (_lists_of(candidates, sensor_count), in_columns, others):
        if guessed and sensor_count in (None, len(guessed)):
            doubt = "no name or type says which numbers are readings of a field"
            advice = "name the sensors in a map, or give --array"
            return _in_order(guessed), "" if sensor_count else f"{doubt}: {advice}"
    return [], ""


def _is_scalar(vector: Vector) -> bool:
    return NAMES["scalar"].search("" if vector.table.is_text else vector.table.name) is not None


def _in_columns(table: Table, sensor_count: int) -> list[Vector]:
    """Return the vectors of columns without names that are three for each sensor, and at most one more."""
    is_unnamed = table.is_text and table.columns == tuple(map(str, range(1, len(table.columns) + 1)))
    if not is_unnamed or len(table.fields) - 3 * sensor_count not in (0, 1):
        return []
    starts = range(0, 3 * sensor_count, 3)
    return [Vector(table, f"{first // 3:03d}", table.fields[first : first + 3]) for first in starts]


def _lists_of(candidates: Sequence[Vector], sensor_count: int | None) -> list[Vector]:
    """Return the vectors of lists that have three numbers for each sensor, and at most one more."""
    found = []
    for vector in candidates:
        if vector.pattern.endswith("..]") and not vectors.OTHER.search(vector.pattern):
            count = vectors.lists_in(vector.table.fields)[vector.pattern.rpartition("[")[0]]
            if count - 3 * (sensor_count or count // 3) in (0, 1):
                found.append(vector)
    return found


def _rawest(magnetic: Sequence[Vector], sensor_count: int | None) -> tuple[list[Vector], str]:
    """Return the sensors among vectors that were processed least; among others, where only these are the array's."""
    equal = [[each for each in magnetic if each.changes == changes] for changes in range(3)]
    found = [_sensors(each, sensor_count) for each in equal if each] or [([], "")]
    certain = [each for each in found if not each[1]] if sensor_count else []
    return (certain or found)[0]


def _sensors(magnetic: Sequence[Vector], sensor_count: int | None) -> tuple[list[Vector], str]:
    """Return the vectors that are the sensors, in their order, and why that is not certain."""
    groups: dict[tuple[str, str], list[Vector]] = defaultdict(list)
    for vector in magnetic:
        groups[vector.table.type, _NUMBER.sub("", f"{vector.table.name} {vector.pattern}")].append(vector)
    found = sorted(groups.values(), key=lambda group: -len(group))
    fitting = [group for group in found if len(group) == (sensor_count or len(found[0]))]
    if sensor_count:
        are_together = not fitting and len(magnetic) == sensor_count
    else:
        are_together = len(fitting) > 1 and len(found[0]) == 1 and len({each.table.type for each in magnetic}) == 1
    if are_together:
        fitting = [list(magnetic)]
    named = ", ".join(sorted(str(vector.pick) for vector in magnetic))
    if len(fitting) == 1:
        return _in_order(fitting[0]), ""
    if fitting:
        return _in_order(fitting[0]), f"several sets of sensors may be meant ({named}): name one in the map"
    doubt = f"{len(magnetic)} magnetic vectors are there ({named}), and the array has {sensor_count} sensors"
    return _in_order(found[0])[:sensor_count], f"{doubt}: name the sensors in the map"


def _in_order(candidates: Sequence[Vector]) -> list[Vector]:
    """Return vectors by the numbers in their names, else by the alphabet."""
    return sorted(candidates, key=lambda vector: vector.place)


def _order_doubt(sensors: Sequence[Vector]) -> str:
    """Return why the order of sensors is not certain; empty where numbers or single letters in their names tell it."""
    named = [f"{vector.table.name} {vector.table.instance} {vector.pattern}" for vector in sensors]
    numbers = [list(map(int, _NUMBER.findall(name))) for name in named]
    words = [re.findall(r"[A-Z]?[a-z]+|[A-Z]+", name) for name in named]
    own = [" ".join(word for word in each if not all(word in other for other in words)) for each in words]
    if all(one < other for one, other in pairwise(numbers)) or all(len(name) == 1 for name in own):
        return ""
    listed = f"sensors 1 to {len(own)} are {', '.join(own)} in alphabetical order"
    return f"{listed}, as no number in their names tells: confirm it with a map or frame_ids"


def _scalars(
    tables: Sequence[Table], candidates: Sequence[Vector], sensors: Sequence[Vector]
) -> tuple[list[Pick], list[str]]:
    """Return what is taken for the readings of a scalar magnetometer, and what else may be."""
    of_sensors = {vector.table.key for vector in sensors}
    of_vectors = {field for vector in candidates for field in vector.fields}
    picks, others = [vector.pick for vector in candidates if is_magnetic(vector) and _is_scalar(vector)], []
    for table in tables:
        single = [field for field in table.fields if field not in of_vectors and not is_bookkeeping(field)]
        is_named = NAMES["scalar"].search(table.name) is not None
        has_sensor = table.is_text or table.key in of_sensors
        for field in single:
            unit = vectors.unit_in(table, field)
            is_of_field = has_sensor or unit or vectors.MAGNETIC.search(f"{field} {table.name}")
            is_scalar = is_of_field and NAMES["scalar"].search(vectors.UNIT_SUFFIX.sub("", field))
            pick = vectors.pick_of(table, field, unit=unit)
            if (is_named and len(single) == 1) or is_scalar or (has_sensor and _is_last(table, field)):
                picks.append(pick)
            elif is_named or unit:
                others.append(str(pick) if unit else table.title)
    return picks, list(dict.fromkeys(others))


def _is_last(table: Table, field: str) -> bool:
    """Whether a place of a list, or a column without a name, is one more than vectors need."""
    path = field.rpartition("[")[0]
    same = [name for name in table.fields if name.rpartition("[")[0] == path] if path else list(table.fields)
    is_unnamed = field.isdigit() or path != ""
    return is_unnamed and len(same) > 3 and len(same) % 3 == 1 and field == same[-1]


def _channels(
    tables: Sequence[Table], scalars: list[Pick], sensors: Sequence[Vector]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Return the channels recorded with the sensors, and what was not taken because there are several."""
    found = {
        "scalar": scalars,
        "attitude": [pick for table in tables for pick in vectors.attitudes_in(table)],
        "gyroscope": [vector.pick for table in tables for vector in vectors_in(table) if vectors.is_rate(vector)],
        "temperature": [],
        "current": [],
    }
    for table in tables:
        if table.type == TEMPERATURE:
            found["temperature"].append(Pick(topic=table.name))
            continue
        single = [field for field in table.fields if not is_bookkeeping(field) and "[" not in field]
        for field in single:
            named = field if table.is_text or len(single) > 1 else f"{table.name} {field}"
            if NAMES["temperature"].search(named):
                found["temperature"].append(vectors.pick_of(table, field))
            elif NAMES["current"].search(named.rpartition(".")[2]):
                found["current"].append(vectors.pick_of(table, field))
    channels, remarks, tables_of_sensors = {}, [], {vector.table.key for vector in sensors}
    for name, picks in found.items():
        own = [pick for pick in picks if pick.table in tables_of_sensors]
        taken = picks if len(picks) == 1 else own if len(own) == 1 else []
        if taken:
            channels[name] = taken[0]
        elif picks:
            listed = shortened(list(map(str, picks)), " or ", 4)
            remarks.append(f"{in_words(name)} may be {listed}: name one in the map")
    return channels, tuple(remarks)


def reason(stream: str, wanted: Wanted) -> str:
    """Return what a choice was made by: the type of the messages, a name, or the place among other numbers."""
    table, fields = wanted
    if table.type in (MAGNETIC_FIELD, IMU, TEMPERATURE):
        return f"type {table.type.rpartition('/')[2]}"
    named = [vector for vector in vectors_in(table) if vector.fields == fields and is_magnetic(vector)]
    is_placed = not named if stream.startswith("tam_") else stream == "scalar" and _is_last(table, fields[0])
    return "place" if is_placed else "name"


def _described(table: Table) -> str:
    if table.type:
        return f"{table.title} ({table.type})"
    return f"{table.title} ({shortened(table.fields)})" if table.title else f"columns {shortened(table.fields)}"
