"""Reproduced numbers as the cells of a table, the same in a terminal and on a page."""

import math
from collections.abc import Sequence
from typing import get_args

from tam_calibration.report.formatting import fixed, number
from tam_calibration.reproduce.row import Row, Status

HEADER = ("number", "paper", "ours", "unit", "ratio", "status", "note")
STATUSES: tuple[Status, ...] = get_args(Status)


def notes(rows: Sequence[Row]) -> list[str]:
    """Return the different reasons, in the order of their numbers from 1."""
    return list(dict.fromkeys(row.reason for row in rows if row.reason))


def tally(rows: Sequence[Row]) -> list[int]:
    """Return how many rows have each of ``STATUSES``."""
    return [sum(row.status == status for row in rows) for status in STATUSES]


def cells(rows: Sequence[Row]) -> list[list[str]]:
    """Return the cells of the rows under ``HEADER``."""
    numbers = {reason: str(index) for index, reason in enumerate(notes(rows), start=1)}
    return [
        [
            row.name,
            _printed(row),
            _ours(row),
            "" if row.unit == "1" else row.unit,
            _ratio(row.ratio),
            row.status if row.is_as_recorded else f"{row.status}, recorded as {row.recorded}",
            numbers.get(row.reason, ""),
        ]
        for row in rows
    ]


def _printed(row: Row) -> str:
    return _signed(row.paper) if row.unit == "sign" else _plain(row.paper)


def _ours(row: Row) -> str:
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
