"""The results of a batch as tables for people in a terminal."""

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table

from tam_calibration.fleet.parameters import all_drifts
from tam_calibration.fleet.result import Result
from tam_calibration.fleet.rows import COUNTS_HEADER, DRIFT_HEADER, count_rows, drift_row, largest, open_points


def print_batch(console: Console, results: Sequence[Result]) -> None:
    """Print counts by platform, the drift of each kind of parameter that stands out most, and what is open."""
    console.print(_table("What was found", COUNTS_HEADER, count_rows(results)))
    drifts = [drift_row(found)[:-1] for found in largest(all_drifts(results))]
    if drifts:
        console.print(_table("Largest drift of each kind, ± standard errors", DRIFT_HEADER[:-1], drifts))
    for point in open_points(results):
        console.print(point)


def _table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(header[0], title=title)
    for name in header[1:]:
        table.add_column(name, justify="right")
    for row in rows:
        table.add_row(*row)
    return table
