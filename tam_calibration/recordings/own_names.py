"""Recordings that have the names of ours: the topics of the collector, or the columns that this package writes."""

import re
from collections.abc import Sequence
from typing import cast

from tam_calibration.messages.topics import CHANNEL_TOPICS, sensor_topic
from tam_calibration.model.conversion import ATTITUDE_COLUMNS, POSITION_COLUMNS, RATE_COLUMNS
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.further_channels import is_further, named_by, require_further
from tam_calibration.model.recording import require_sensor_count
from tam_calibration.model.units import TESLA_PER_FIELD_UNIT
from tam_calibration.recordings.channel_map import ChannelMap, FieldUnit, Pick
from tam_calibration.recordings.navigation import GEOGRAPHIC_COLUMNS
from tam_calibration.recordings.tables import Table

_OWN_FIELD = re.compile(rf"(b([1-9]\d{{,8}})[xyz]|scalar)_({'|'.join(TESLA_PER_FIELD_UNIT)})")
_OWN_CHANNELS = {"temperature": "temperature_C", "current": "current_A"}


def is_own_column(name: str) -> bool:
    """Return whether a column has one of the names of ours."""
    vectors = (*ATTITUDE_COLUMNS, *RATE_COLUMNS, *POSITION_COLUMNS, *GEOGRAPHIC_COLUMNS)
    known = ("time_s", *vectors, *_OWN_CHANNELS.values())
    return name in known or is_further(name) or _OWN_FIELD.fullmatch(name) is not None


def unread(tables: Sequence[Table]) -> list[str]:
    """Return the columns of tables that are none of ours."""
    return [name for table in tables for name in table.columns if not is_own_column(name)]


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
        axes = [matches.get(f"b{number}{axis}") for axis in "xyz"]
        for axis, match in zip("xyz", axes, strict=True):
            if match is None:
                raise InputError(f"column b{number}{axis}_nT is missing (of {max(numbers)} sensors)")
        units = {match[3] for match in axes if match}
        if len(units) > 1:
            raise InputError(f"the columns of sensor {number} are in {' and '.join(sorted(units))}: give them one unit")
        sensors.append(Pick(columns=[match[0] for match in axes if match], unit=cast(FieldUnit, units.pop())))
    channels = {name: Pick(column=column) for name, column in _OWN_CHANNELS.items() if column in fields}
    if scalar := matches.get("scalar"):
        channels["scalar"] = Pick(column=scalar[0], unit=cast(FieldUnit, scalar[3]))
    if set(POSITION_COLUMNS) & set(fields) and set(GEOGRAPHIC_COLUMNS) & set(fields):
        raise InputError("the position is there twice: keep x_m, y_m, z_m or lat_deg, lon_deg, depth_m")
    for channel, columns in (
        ("attitude", ATTITUDE_COLUMNS),
        ("gyroscope", RATE_COLUMNS),
        ("position", POSITION_COLUMNS),
        ("position", GEOGRAPHIC_COLUMNS),
    ):
        if set(columns) & set(fields):
            if missing := [name for name in columns if name not in fields]:
                raise InputError(f"column {missing[0]} is missing (of {', '.join(columns)})")
            channels[channel] = Pick(columns=list(columns))
    further = {name: Pick(column=name) for name in require_further(filter(is_further, fields))}
    return ChannelMap.of(sensors, channels, further)


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
    channels = {name: Pick(topic=space + topic) for name, topic in CHANNEL_TOPICS.items() if space + topic in topics}
    relative = {topic: named_by(topic.removeprefix(space)) for topic in sorted(topics) if topic.startswith(space)}
    further = {name: Pick(topic=topic) for topic, name in relative.items() if name}
    return ChannelMap.of(sensors, channels, further)
