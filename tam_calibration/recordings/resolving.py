"""The tables and fields that a map means."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace

from tam_calibration.messages.missing import in_words
from tam_calibration.messages.point_cloud import IMU
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.recordings.channel_map import CHANNEL_WIDTHS, ChannelMap, Pick
from tam_calibration.recordings.joining import Streams
from tam_calibration.recordings.navigation import POSITION_FIELDS
from tam_calibration.recordings.tables import Source, Table, Wanted
from tam_calibration.recordings.vectors import attitudes_in, is_bookkeeping, is_magnetic, shortened, unit_in, vectors_in

NAMES = {
    "scalar": re.compile(
        r"scalar|intensity|gesamt|overhauser|total|proton|potassium|ca?esium|absolute"
        r"|(^|[^a-z])[f](?=$|[^a-z])|(^|[^a-z])b(tot|abs)",
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
    stated = {stream: unit_in(each.table, each.fields[0]) for stream, each in wanted.items()}
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
    fitting = [field for field in single if stream in NAMES and NAMES[stream].search(field)]
    if 1 in widths and len(fitting) == 1:
        return tuple(fitting)
    kind = f"has the type {table.type}" if table.type else "is a table"
    raise InputError(
        f"{table.title} {kind}, and the map does not say which of its fields is {in_words(stream)}: "
        f"it has {shortened(table.fields)}"
    )
