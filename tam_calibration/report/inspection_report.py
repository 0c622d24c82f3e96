"""An inspection, as rows for the terminal and as a page: what a recording contains, and every channel over time."""

from collections.abc import Iterator
from itertools import cycle
from pathlib import Path

from tam_calibration.recordings.inspection import InspectedChannel, InspectedTable, Inspection
from tam_calibration.report.blocks import Block, Code, Image, Points, Section, Table, Text, count, number
from tam_calibration.report.page import COLORS, PAGE_WIDTH_INCH, embed, in_style, new_figure, write_page

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


_MOST_CHANNELS = 200
"""Channels that are drawn: a page of more takes a minute to draw, and a browser as long to show."""


def _choice(found: Inspection) -> list[Block]:
    """Return what would be taken for what, and what is ambiguous."""
    certain = "A choice can be made." if found.is_certain else "The choice has to be settled in a map:"
    blocks: list[Block] = [Text(certain, "good" if found.is_certain else "doubt")]
    blocks += [Points(points) for points in (found.doubts, found.remarks) if points]
    if found.reasons:
        blocks += [Text("What is taken for what, and why:"), Points(found.reasons)]
    return [*blocks, Code(found.map_yaml(), "The map, to be edited and given with --map.")]


def _over_time(found: Inspection) -> list[Block]:
    """Return every channel over time."""
    blocks: list[Block] = [
        Text(
            "Numbers as recorded. Each stroke spans the smallest to the largest of consecutive values, so that single "
            "spikes are seen. x is brown, y blue, z black and w grey."
        )
    ]
    left = _MOST_CHANNELS
    for table in found.tables:
        shown = [channel for channel in table.channels if len(channel.course.time_s)][:left]
        left -= len(shown)
        if shown:
            blocks.append(_picture(table, shown))
    drawn = _MOST_CHANNELS - left
    if drawn < (whole := sum(len(table.channels) for table in found.tables)):
        blocks.append(Text(f"{drawn} of {whole} channels are drawn."))
    return blocks if drawn else []


@in_style
def _picture(table: InspectedTable, channels: list[InspectedChannel]) -> Image:
    from tam_calibration.report.recording_plots import time_axis

    figure = new_figure(PAGE_WIDTH_INCH, 0.6 + 1.1 * len(channels))
    rows = figure.subplots(len(channels), 1, sharex=True, squeeze=False)[:, 0]
    has_time = bool(table.time) and table.time != "none"
    last = max(float(channel.course.time_s[-1]) for channel in channels)
    unit, seconds = time_axis(last) if has_time else ("rows", 1.0)
    for axes, channel in zip(rows, channels, strict=True):
        course = channel.course
        for low, high, color in zip(course.low.T, course.high.T, cycle(COLORS[:4]), strict=False):
            axes.vlines(course.time_s / seconds, low, high, color=color, linewidth=0.8, rasterized=True)
            axes.plot(course.time_s / seconds, low, color=color, linewidth=0.4, rasterized=True)
        axes.set_title(channel.title, loc="left")
        axes.set_title(" ".join(part for part in (channel.taken_as, channel.unit) if part), loc="right")
    rows[-1].set_xlabel(f"time from the beginning ({unit})" if has_time else unit)
    title = f"{table.name or 'Columns'} over time"
    return embed(figure, title, title)


def write_inspection_report(path: Path, found: Inspection) -> None:
    """Write a self-contained HTML page about what a recording contains.

    Parameters
    ----------
    path : Path
        File to write; nothing is left there when writing fails, and an older file stays as it was.
    found : Inspection
        What was found.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    sections = [
        Section("Choice", _choice(found)),
        Section("What is odd", [Points(found.oddities) if found.oddities else Text("Nothing.", "good")]),
        Section("Content", [Table(HEADER, list(rows_of(found, most=_MOST_CHANNELS)), numeric=False)]),
        Section("Over time", _over_time(found)),
    ]
    write_page(path, "Inspection report", headline(found), sections)
