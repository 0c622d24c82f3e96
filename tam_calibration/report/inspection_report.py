"""The report on an inspection: what a recording contains, and every channel over time."""

from itertools import cycle
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from tam_calibration.recordings.inspection import InspectedChannel, InspectedTable, Inspection
from tam_calibration.report.blocks import Block, Code, Image, Points, Section, Table, Text
from tam_calibration.report.inspection_rows import HEADER, headline, rows_of
from tam_calibration.report.page import COLORS, PAGE_WIDTH_INCH, STYLE, embed, write_page
from tam_calibration.report.recording_plots import time_axis

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


@matplotlib.rc_context(STYLE)
def _picture(table: InspectedTable, channels: list[InspectedChannel]) -> Image:
    figure = Figure(figsize=(PAGE_WIDTH_INCH, 0.6 + 1.1 * len(channels)), layout="constrained")
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
