"""Tables and figures of the papers that are compared with nothing, and why: each paper's module has its own."""

from dataclasses import dataclass
from importlib import import_module

PICTURE = "simulated, the values in a picture only, which was not at hand"


@dataclass(frozen=True)
class NotCompared:
    """What a paper holds, and no row of its comparison.

    Parameters
    ----------
    item : str
        Table or figure, and what of it.
    reason : str
        Why it is not simulated, or not compared.
    """

    item: str
    reason: str


def not_compared(paper: str) -> tuple[NotCompared, ...]:
    """Return what of a paper is compared with nothing.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    items: tuple[NotCompared, ...] = import_module(f"tam_validation.papers.{paper}").NOT_COMPARED
    return items
