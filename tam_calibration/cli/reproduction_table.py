"""Reproduced papers as tables for people in a terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from tam_calibration.report.reproduction_cells import HEADER, STATUSES, cells, notes, tally
from tam_calibration.reproduce.row import Row

_NUMERIC = {"paper", "ours", "ratio"}


def print_rows(console: Console, title: str, rows: Sequence[Row]) -> None:
    """Print every number of a paper, and the notes under them."""
    table = Table(title=title)
    for heading in HEADER:
        table.add_column(heading, justify="right" if heading in _NUMERIC else "left")
    for row, texts in zip(rows, cells(rows), strict=True):
        table.add_row(*texts, style=None if row.is_as_recorded else "bold")
    console.print(table)
    for index, note in enumerate(notes(rows), start=1):
        console.print(f"{index:>3} {note}")


def summary(paper: str, rows: Sequence[Row]) -> str:
    """Return one line on a paper: how many of its numbers have which status."""
    counts = ", ".join(f"{count} {status}" for count, status in zip(tally(rows), STATUSES, strict=True))
    return f"{paper}: {len(rows)} numbers, {counts}"
