"""A gap as tables for people in a terminal."""

from rich.console import Console
from rich.table import Table

from tam_calibration.gap.result import Cause, Gap
from tam_calibration.report.formatting import sentence
from tam_calibration.report.gap_rows import (
    CAUSES_HEADER,
    NOISE_HEADER,
    SIZE_HEADER,
    cause_row,
    closed_words,
    noise_rows,
    parameter_rows,
    place,
    size_rows,
    where_words,
)
from tam_calibration.report.gap_words import cause_words, set_words, unseen_words

_ROWS = 12
_LEFT = "What is left with the causes, and the simulated twin does not have:"


def print_gap(console: Console, gap: Gap) -> None:
    """Print the verdict, the size, where it lies, its causes, what became of each hypothesis, and what to record."""
    sensor_count = len(gap.residue.floor_T) // 3
    for remark in gap.remarks:
        console.print(remark, soft_wrap=True)
    console.print(gap.headline, style="bold", soft_wrap=True)
    if gap.verdict != "not_identifiable":
        console.print(_table(SIZE_HEADER, size_rows(gap.size)))
    if gap.floor is not None:
        console.print(_table(NOISE_HEADER, noise_rows(gap.floor)))
    if gap.where.sensors:
        console.print(f"Where: {where_words(gap.where, sensor_count)}.")
    if gap.causes:
        console.print(f"{sentence(closed_words(gap.size))}")
        console.print(_table(CAUSES_HEADER, [cause_row(cause, sensor_count) for cause in gap.causes]))
    for cause in gap.causes:
        _print_parameters(console, cause, place(cause.sensors, cause.axes, sensor_count))
        for words in cause_words(cause):
            console.print(f"  {words}", soft_wrap=True)
    if gap.remainder:
        console.print(f"What no cause explains: {gap.remainder}", soft_wrap=True)
    for words in (*set_words(gap), *unseen_words(gap)):
        console.print(words, soft_wrap=True)
    if gap.checks is not None and gap.checks.sentences:
        console.print("What the simulated twin does not have:" if not gap.causes else _LEFT)
        for words in gap.checks.sentences:
            console.print(f"  {words}", soft_wrap=True)
    console.print("Hypotheses:")
    for considered in gap.considered:
        status = considered.status.replace("_", " ")
        console.print(f"  {considered.effect}: {status}, {considered.why}", soft_wrap=True)
    if gap.next_recording:
        console.print(f"Next recording: {sentence(gap.next_recording)}")


def _print_parameters(console: Console, cause: Cause, where: str) -> None:
    rows = parameter_rows(cause)
    if not rows:
        return
    console.print(f"{cause.fitted.effect} of {where}:")
    console.print(_table(("parameter", "value ± standard error", "unit"), rows[:_ROWS]))
    if len(rows) > _ROWS:
        console.print(f"… and {len(rows) - _ROWS} more: --json and --report have all.")


def _table(header: tuple[str, ...], rows: list[list[str]]) -> Table:
    table = Table(header[0])
    for name in header[1:]:
        table.add_column(name, justify="left" if name in ("where", "unit", "cannot be told from") else "right")
    for row in rows:
        table.add_row(*row)
    return table
