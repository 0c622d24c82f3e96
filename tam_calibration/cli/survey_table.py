"""A survey as tables for people in a terminal."""

from rich.console import Console
from rich.table import Column, Table

from tam_calibration.report.survey_rows import HEADER, overall_rows, sample_rows, statements
from tam_calibration.survey.result import Survey


def print_survey(console: Console, survey: Survey) -> None:
    """Print the source of all samples, of each, and what holds for them."""
    if survey.overall is not None:
        table = Table("", *_right("x", "y", "z", "size"), title="The source ± standard errors")
        for row in overall_rows(survey.overall):
            table.add_row(*row)
        console.print(table)
    if rows := sample_rows(survey):
        table = Table(*_right(*HEADER), title="Poses" if survey.line else "Samples by themselves")
        for row in rows:
            table.add_row(*row)
        console.print(table)
    for words in statements(survey):
        console.print(words)


def _right(*names: str) -> list[Column]:
    return [Column(name, justify="right") for name in names]
