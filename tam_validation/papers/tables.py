"""Reproduced numbers of the papers: as cells, in a terminal and as CSV."""

import csv
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from io import StringIO
from typing import get_args

from rich.console import Console
from rich.table import Table

from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.report.formatting import fixed, number
from tam_validation.papers.row import PaperNumber, Status
from tam_validation.papers.sweep import Sweep
from tam_validation.papers.wu2025_sweeps import GROUPS, HELD_OUT, IN_SAMPLE, RELATIVE_ERROR

HEADER = ("number", "paper", "source", "ours", "unit", "ratio", "status", "right", "note")
STATUSES: tuple[Status, ...] = get_args(Status)


def notes(rows: Sequence[PaperNumber]) -> list[str]:
    """Return the different reasons, in the order of their numbers from 1."""
    return list(dict.fromkeys(row.reason for row in rows if row.reason))


def tally(rows: Sequence[PaperNumber]) -> list[int]:
    """Return how many rows have each of ``STATUSES``."""
    return [sum(row.status == status for row in rows) for status in STATUSES]


def cells(rows: Sequence[PaperNumber]) -> list[list[str]]:
    """Return the cells of the rows under ``HEADER``."""
    numbers = {reason: str(index) for index, reason in enumerate(notes(rows), start=1)}
    return [
        [
            row.name,
            _signed(row.paper) if row.unit == "sign" else _plain(row.paper),
            row.source,
            _ours(row),
            "" if row.unit == "1" else row.unit,
            _ratio(row.ratio),
            row.status if row.is_as_recorded else f"{row.status}, recorded as {row.recorded}",
            f"{_plain(row.right)}, {row.right_source}" if row.right_source else "",
            numbers.get(row.reason, ""),
        ]
        for row in rows
    ]


def _ours(row: PaperNumber) -> str:
    if row.unit == "sign":
        return _signed(row.ours)
    # Adding zero takes the sign of a negative one.
    return fixed(round(row.ours, 3) + 0.0, 3) if row.unit == "exponent" else _plain(row.ours)


def _signed(value: float) -> str:
    return f"{value:+.0f}".replace("-", "−")


def _plain(value: float) -> str:
    return "–" if math.isnan(value) else f"{value:.7g}".replace("-", "−")


def _ratio(ratio: float) -> str:
    if not math.isfinite(ratio):
        return "–"
    return fixed(ratio, 4) if abs(ratio) < 10 else number(ratio)


_NUMERIC = {"paper", "ours", "ratio"}


def print_rows(console: Console, title: str, rows: Sequence[PaperNumber]) -> None:
    """Print the numbers of a paper that are compared, and the notes under them.

    Parameters
    ----------
    console : rich.console.Console
        Where to print.
    title : str
        Of the table.
    rows : sequence of PaperNumber
        Numbers of the paper beside ours.
    """
    table = Table(title=title)
    for heading in HEADER:
        table.add_column(heading, justify="right" if heading in _NUMERIC else "left")
    for row, texts in zip(rows, cells(rows), strict=True):
        table.add_row(*texts, style=None if row.is_as_recorded else "bold")
    console.print(table)
    for index, note in enumerate(notes(rows), start=1):
        console.print(f"{index:>3} {note}")


def print_not_compared(console: Console, title: str, items: Mapping[str, str]) -> None:
    """Print what of a paper is compared with nothing, and why.

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
    """Return one line on a paper: how many of the numbers that are compared have which status.

    Parameters
    ----------
    paper : str
        Name of the paper.
    rows : sequence of PaperNumber
        Its numbers beside ours.
    """
    counts = ", ".join(f"{count} {status}" for count, status in zip(tally(rows), STATUSES, strict=True))
    return f"{paper}: {len(rows)} numbers, {counts}"


_ROW_HEADER = (
    "number", "unit", "paper", "paper_source", "ours", "ratio", "status", "recorded", "right", "right_source", "reason",
)  # fmt: skip
_DATA = (IN_SAMPLE, HELD_OUT)
_SWEEP_HEADER = (
    "sweep", "setting", "unit", "value", "source",
    *(f"mean relative error, {group}" for group in GROUPS),
    *(f"e_B{sensor}_nT {data}" for data in _DATA for sensor in range(1, 5)),
    *(f"e_T_nT_per_m {data}" for data in _DATA),
)  # fmt: skip


def rows_to_csv(rows: Sequence[PaperNumber], command: str) -> str:
    """Return the numbers of a paper that are compared as CSV.

    Parameters
    ----------
    rows : sequence of PaperNumber
        Numbers of the paper beside ours.
    command : str
        The command that makes the file, for its first line.
    """
    lines = [
        (
            row.name,
            row.unit,
            f"{row.paper:.9g}",
            row.source,
            *_numbers(row.ours, row.ratio),
            row.status,
            row.recorded,
            f"{row.right:.9g}" if row.right_source else "",
            row.right_source,
            row.reason,
        )
        for row in rows
    ]
    return _to_csv(command, _ROW_HEADER, lines)


def sweeps_to_csv(sweeps: Mapping[str, Sweep], command: str) -> str:
    """Return the curves of the figures as CSV: means over the runs, and over the parameters of a kind.

    Parameters
    ----------
    sweeps : mapping of str to Sweep
        The sweeps of Wu 2025 by name.
    command : str
        The command that makes the file, for its first line.
    """
    return _to_csv(command, _SWEEP_HEADER, [line for sweep in sweeps.values() for line in _lines(sweep)])


def _lines(sweep: Sweep) -> Iterator[Sequence[str]]:
    plan = sweep.plan
    for source in dict.fromkeys(source for source, _ in sweep.values):
        means = {quantity: sweep.mean(source, quantity) for other, quantity in sweep.values if other == source}
        for index, value in enumerate(plan.points):
            point = {quantity: mean[index] for quantity, mean in means.items()}
            yield plan.name, plan.symbol, plan.unit, f"{value:g}", source, *_relative(point), *_residuals(point)


def _relative(point: Mapping[str, FloatArray]) -> list[str]:
    error = point.get(RELATIVE_ERROR)
    return [""] * len(GROUPS) if error is None else _numbers(*(error[columns].mean() for columns in GROUPS.values()))


def _residuals(point: Mapping[str, FloatArray]) -> list[str]:
    keys = [f"{quantity} {data}" for quantity in ("e_B", "e_T") for data in _DATA]
    if keys[0] not in point:
        return [""] * 10
    return _numbers(*(to_nanotesla(value) for key in keys for value in point[key]))


def _numbers(*values: float) -> list[str]:
    return [f"{value:.7g}" for value in values]


def _to_csv(command: str, header: Sequence[str], lines: Iterable[Sequence[str]]) -> str:
    text = StringIO()
    text.write(f"# {command}\n")
    csv.writer(text, lineterminator="\n").writerows([header, *lines])
    return text.getvalue()
