"""A figure beside what is asked of it."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import inf

from rich.console import Console
from rich.table import Table

ANYTHING = (0.0, inf)


@dataclass(frozen=True)
class Figure:
    """A figure with its standard error, and what is asked of it."""

    case: str
    method: str
    name: str
    value: float
    standard_error: float = float("nan")
    asked: tuple[float, float] = ANYTHING

    @property
    def asked_in_words(self) -> str:
        """The bounds, or nothing."""
        least, most = self.asked
        return "" if self.asked == ANYTHING else f"≤ {most:g}" if least == 0 else f"{least:g} to {most:g}"

    @property
    def verdict(self) -> str:
        """Whether it is met, or nothing."""
        return "" if self.asked == ANYTHING else "yes" if self.asked[0] <= self.value <= self.asked[1] else "NO"

    @property
    def line(self) -> str:
        """The row of a CSV file: case, method, figure, value, standard error, asked, met."""
        words = f'"{self.case}","{self.method}","{self.name}"'
        return f"{words},{self.value:.6g},{self.standard_error:.2g},{self.asked_in_words},{self.verdict}"


def show(figures: Sequence[Figure], title: str, method: str) -> None:
    """Print figures in a table; what their methods are is the heading of the second column."""
    table = Table("case", method, "figure", "measured", "asked", "met", title=title)
    for figure in figures:
        value = f"{figure.value:.3g}"
        table.add_row(figure.case, figure.method, figure.name, value, figure.asked_in_words, figure.verdict)
    Console(width=140).print(table)
