"""The map of an inspection: units, time and text format as they were found, to be edited."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

from tam_calibration.messages.missing import in_words
from tam_calibration.recordings.channel_map import ChannelMap, FieldUnit, Pick, TextFormat, TimeColumn
from tam_calibration.recordings.inspection_result import InspectedChannel
from tam_calibration.recordings.intake import size_doubt
from tam_calibration.recordings.row_source import NO_TIME_RATE_HZ, RowSource
from tam_calibration.recordings.tables import Source
from tam_calibration.recordings.text_source import TextSource


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
    channel_map: ChannelMap,
    channels: Mapping[str, InspectedChannel],
    sources: Sequence[Source],
    is_received: bool,
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
