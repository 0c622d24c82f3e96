"""Rows of the tables on an inspection, for the terminal and the page."""

from collections.abc import Iterator

from tam_calibration.recordings.inspection import InspectedChannel, InspectedTable, Inspection
from tam_calibration.report.formatting import count, number

HEADER = ("topic or column", "type", "count", "rate (Hz)", "times or range", "missing", "recorded in", "taken as")


def headline(found: Inspection) -> str:
    """Return what was read in one line."""
    names = ", ".join(file.name for file in found.files)
    duration = f", {number(found.duration_s, 4)} s" if found.duration_s > 0 else ""
    return f"{names}: {found.format}{duration}"


def rows_of(found: Inspection, most: int) -> Iterator[list[str]]:
    """Yield a row for each table and each of its channels.

    Parameters
    ----------
    found : Inspection
        What a recording contains.
    most : int
        Channels of a table that are shown in addition to those taken.
    """
    for table in found.tables:
        yield _table_row(table, found)
        others = [channel for channel in table.channels if not channel.taken_as]
        shown = {id(channel) for channel in others[:most]}
        yield from (_channel_row(each) for each in table.channels if each.taken_as or id(each) in shown)
        if len(others) > most:
            yield [f"  … and {len(others) - most} more", *[""] * (len(HEADER) - 1)]


def _table_row(table: InspectedTable, found: Inspection) -> list[str]:
    name = table.name or found.files[0].name
    messages = "–" if table.count is None else count(table.count)
    return [name, table.type.rpartition("/")[2], messages, number(table.rate_hz), table.time, "", "", ""]


def _channel_row(channel: InspectedChannel) -> list[str]:
    factor, shown = (channel.nanotesla, " nT") if channel.unit else (1.0, "")
    span = f"{number(min(channel.low) * factor, 5)} to {number(max(channel.high) * factor, 5)}{shown}"
    unit = channel.unit if channel.is_unit_stated or not channel.unit else f"{channel.unit} (detected)"
    missing = count(sum(channel.missing.values())) if channel.missing else ""
    return [f"  {channel.title}", "", "", "", span, missing, unit, channel.taken_as]
