"""One number that a paper prints, beside ours."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from tam_calibration.model.units import FloatArray

Status = Literal["reproduced", "not reproduced", "paper in error"]


@dataclass(frozen=True)
class PrintedNumber:
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
    recorded : str
        The status that was found when the paper was examined; another one is a regression.
    """

    name: str
    paper: float
    ours: float
    unit: str
    status: Status
    reason: str = ""
    recorded: Status = "reproduced"

    @property
    def is_as_recorded(self) -> bool:
        """Whether the status is still the one that was found."""
        return self.status == self.recorded

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
    recorded: Status = "reproduced",
) -> list[PrintedNumber]:
    """Return the rows of numbers that are reproduced where they agree to a relative or an absolute tolerance.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        As printed, and as computed here; as many as names.
    unit : str
        Of all of them.
    relative : float
        Largest difference that agrees, as part of the printed number.
    absolute : float
        The same in the unit; the larger of the two tolerances counts.
    reason : str
        Why a number is not reproduced; it stands at those rows only.
    recorded : str
        The status that was found when the paper was examined.
    """
    rows = []
    for name, printed, value in zip(names, paper, ours, strict=True):
        agrees = _agrees(float(value), printed, relative, absolute)
        status: Status = "reproduced" if agrees else "not reproduced"
        rows.append(PrintedNumber(name, printed, float(value), unit, status, "" if agrees else reason, recorded))
    return rows


def compare_together(
    names: Iterable[str],
    paper: Sequence[float],
    ours: Sequence[float] | FloatArray,
    unit: str,
    *,
    relative: float,
    reason: str,
    recorded: Status,
) -> list[PrintedNumber]:
    """Return the rows of numbers that are one finding: reproduced where all of them agree, and otherwise none.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        As printed, and as computed here; as many as names.
    unit : str
        Of all of them.
    relative : float
        Largest difference that agrees, as part of the printed number.
    reason : str
        Why they are not reproduced; it stands at all rows then.
    recorded : str
        The status that was found when the paper was examined.
    """
    rows = compare(names, paper, ours, unit, relative=relative, reason=reason, recorded=recorded)
    if all(row.status == "reproduced" for row in rows):
        return rows
    return [replace(row, status="not reproduced", reason=reason) for row in rows]


def correct_paper(
    names: Iterable[str],
    paper: Sequence[float],
    ours: Sequence[float] | FloatArray,
    unit: str,
    reason: str,
    *,
    right: Sequence[float] | FloatArray,
    relative: float = 0.0,
    absolute: float = 0.0,
) -> list[PrintedNumber]:
    """Return the rows of numbers in which the paper is wrong, for a reason that makes ours the right ones.

    Where ours does not agree to what is right, the reason does not hold and the row is not reproduced.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        As printed, and as computed here; as many as names.
    unit : str
        Of all of them.
    reason : str
        What is wrong in the paper.
    right : sequence of float
        What ours must agree with for the reason to hold; as many as names.
    relative : float
        Largest difference of ours from what is right, as part of the latter.
    absolute : float
        The same in the unit; the larger of the two tolerances counts.
    """
    rows = []
    for name, printed, value, true in zip(names, paper, ours, right, strict=True):
        status: Status = "paper in error" if _agrees(float(value), true, relative, absolute) else "not reproduced"
        rows.append(PrintedNumber(name, printed, float(value), unit, status, reason, recorded="paper in error"))
    return rows


def _agrees(value: float, to: float, relative: float, absolute: float) -> bool:
    return abs(value - to) <= max(absolute, relative * abs(to))
