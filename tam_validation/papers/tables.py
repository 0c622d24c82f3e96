"""Reproduced numbers of the papers: as cells, in a terminal and as CSV."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from io import StringIO
from typing import get_args

from rich.console import Console
from rich.table import Table

from tam_validation.papers.row import Draws, PaperNumber, Status
from tam_validation.papers.wu2025_sweeps import GROUPS, SWEEPS

HEADER = ("number", "paper", "source", "ours", "95 % range", "unit", "status", "right", "note")
STATUSES: tuple[Status, ...] = get_args(Status)


def notes(rows: Sequence[PaperNumber]) -> list[str]:
    """Return the different notes, in the order of their numbers from 1."""
    return list(dict.fromkeys(row.note for row in rows if row.note))


def tally(rows: Sequence[PaperNumber]) -> list[int]:
    """Return how many rows have each of ``STATUSES``."""
    return [sum(row.status == status for row in rows) for status in STATUSES]


def cells(rows: Sequence[PaperNumber]) -> list[list[str]]:
    """Return the cells of the rows under ``HEADER``."""
    numbers = {note: str(index) for index, note in enumerate(notes(rows), start=1)}
    return [
        [
            row.name,
            _plain(row.paper, 7),
            row.source,
            _plain(row.ours, 7),
            " to ".join(_plain(end, 5) for end in row.range),
            "" if row.unit == "1" else row.unit,
            row.status,
            f"{_plain(row.right, 7)}, {row.right_source}" if row.right_source else "",
            numbers.get(row.note, ""),
        ]
        for row in rows
    ]


def _plain(value: float, digits: int) -> str:
    # Adding zero takes the sign of a negative one.
    return "–" if math.isnan(value) else f"{value + 0.0:.{digits}g}".replace("-", "−")


_NUMERIC = {"paper", "ours", "95 % range"}


def print_rows(console: Console, title: str, rows: Sequence[PaperNumber]) -> None:
    """Print the numbers of a paper, and the notes under them.

    Parameters
    ----------
    console : rich.console.Console
        Where to print.
    title : str
        Of the table.
    rows : sequence of PaperNumber
        Numbers of the paper with ours.
    """
    table = Table(title=title)
    for heading in HEADER:
        table.add_column(heading, justify="right" if heading in _NUMERIC else "left")
    for texts in cells(rows):
        table.add_row(*texts)
    console.print(table)
    for index, note in enumerate(notes(rows), start=1):
        console.print(f"{index:>3} {note}")


def print_not_compared(console: Console, title: str, items: Mapping[str, str]) -> None:
    """Print what of a paper has no number of ours, and why.

    Parameters
    ----------
    console : rich.console.Console
        Where to print.
    title : str
        Of the table.
    items : mapping
        From tables and figures of the paper to the reasons.
    """
    table = Table("not compared", "reason", title=title)
    for item in items.items():
        table.add_row(*item)
    console.print(table)


def summary(paper: str, rows: Sequence[PaperNumber]) -> str:
    """Return one line on a paper: how many of its numbers have which status.

    Parameters
    ----------
    paper : str
        Name of the paper.
    rows : sequence of PaperNumber
        Its numbers with ours.
    """
    counts = ", ".join(f"{count} {status}" for count, status in zip(tally(rows), STATUSES, strict=True))
    return f"{paper}: {len(rows)} numbers, {counts}"


_RESIDUALS = ("e_B1_nT", "e_B2_nT", "e_B3_nT", "e_B4_nT", "e_T_nT_per_m")
_ROW_HEADER = ("number", "unit", "paper", "source", "ours", "low", "high", "status", "right", "right_source", "note")
_SWEEP_HEADER = (
    "sweep", "setting", "unit", "value",
    *(f"mean relative error, {group}" for group in GROUPS),
    *(f"{name} {stage}" for stage in ("before", "after") for name in _RESIDUALS),
)  # fmt: skip


def rows_to_csv(rows: Sequence[PaperNumber], command: str) -> str:
    """Return the numbers of a paper as CSV.

    Parameters
    ----------
    rows : sequence of PaperNumber
        Numbers of the paper with ours.
    command : str
        The command that makes the file, for its first line.
    """
    lines = [
        (
            row.name,
            row.unit,
            f"{row.paper:.9g}",
            row.source,
            *_numbers(row.ours, *row.range),
            row.status,
            f"{row.right:.9g}" if row.right_source else "",
            row.right_source,
            row.note,
        )
        for row in rows
    ]
    return _to_csv(command, _ROW_HEADER, lines)


def sweeps_to_csv(draws: Draws, command: str) -> str:
    """Return the curves of the figures of Wu 2025 as CSV: means over the seeds.

    Parameters
    ----------
    draws : mapping
        Of the simulations of Wu 2025.
    command : str
        The command that makes the file, for its first line.
    """
    lines = [
        (name, sweep.symbol, sweep.unit, f"{value:g}", *_numbers(*curve))
        for name, sweep in SWEEPS.items()
        for value, curve in zip(sweep.points, draws[name].mean(axis=0).reshape(len(sweep.points), -1), strict=True)
    ]
    return _to_csv(command, _SWEEP_HEADER, lines)


def _numbers(*values: float) -> list[str]:
    return [f"{value:.7g}" for value in values]


def _to_csv(command: str, header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    text = StringIO()
    text.write(f"# {command}\n")
    csv.writer(text, lineterminator="\n").writerows([header, *lines])
    return text.getvalue()
