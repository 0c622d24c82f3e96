"""One number that a paper prints, beside ours."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

from tam_calibration.units import FloatArray

Status = Literal["reproduced", "not reproduced", "paper in error"]


@dataclass(frozen=True)
class Row:
    """A number of a paper and what its simulation gives here.

    Parameters
    ----------
    name : str
        Where it stands in the paper, and what it is.
    paper, ours : float
        As printed, and as computed here.
    unit : str
        Of both.
    status : str
        ``reproduced``, ``not reproduced`` or ``paper in error``.
    reason : str
        Why, in one sentence; empty where nothing is to be said.
    """

    name: str
    paper: float
    ours: float
    unit: str
    status: Status
    reason: str = ""

    @property
    def ratio(self) -> float:
        """Ours divided by the paper's; infinite or NaN where the paper's is zero."""
        return float(self.ours / self.paper) if self.paper else float("nan" if self.ours == 0 else "inf")


def compare(
    names: Iterable[str],
    paper: Sequence[float],
    ours: Sequence[float] | FloatArray,
    unit: str,
    *,
    relative: float = 0.0,
    absolute: float = 0.0,
    reason: str = "",
) -> list[Row]:
    """Return the rows of numbers that are reproduced where they agree to a relative or an absolute tolerance.

    ``reason`` stands at the rows that are not reproduced.
    """
    rows = []
    for name, printed, value in zip(names, paper, ours, strict=True):
        agrees = abs(float(value) - printed) <= max(absolute, relative * abs(printed))
        status: Status = "reproduced" if agrees else "not reproduced"
        rows.append(Row(name, printed, float(value), unit, status, "" if agrees else reason))
    return rows


def correct_paper(
    names: Iterable[str], paper: Sequence[float], ours: Sequence[float] | FloatArray, unit: str, reason: str
) -> list[Row]:
    """Return the rows of numbers in which the paper is wrong, with the reason."""
    return [
        Row(name, printed, float(value), unit, "paper in error", reason)
        for name, printed, value in zip(names, paper, ours, strict=True)
    ]
