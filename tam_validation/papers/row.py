"""One number of a paper beside ours, where it stands or how it was made of what stands there, and the verdict."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from tam_calibration.model.units import FloatArray

Status = Literal["reproduced", "not reproduced", "paper in error"]
Source = Literal["printed", "derived from printed numbers", "said in words", "theory", "our own earlier result"]
"""Where a number is from.

Printed in the paper; worked out from what is printed there; what it says in words, put into a number by us (straight
growth an exponent of 1, alignment an angle of 0); an equation that the paper does not have; or an earlier run of this
package.
"""

IN_WORDS: Source = "said in words"
DERIVED: Source = "derived from printed numbers"
OUR_OWN: Source = "our own earlier result"


@dataclass(frozen=True)
class PaperNumber:
    """A number of a paper, printed or not, and what its simulation gives here.

    Parameters
    ----------
    name : str
        Where it stands in the paper, and what it is.
    paper, ours : float
        The paper's, and as computed here.
    unit : str
        Of both.
    status : str
        ``reproduced``, ``not reproduced`` or ``paper in error``.
    reason : str
        Why, in one sentence; empty where nothing is to be said.
    recorded : str
        The status that was found when the paper was examined; another one is a regression.
    source : str
        Where the paper's number is from.
    right : float
        Where the paper is taken to be in error, what ours must agree with for that; else NaN.
    right_source : str
        Where the right one is from; empty where there is none.
    """

    name: str
    paper: float
    ours: float
    unit: str
    status: Status
    reason: str = ""
    recorded: Status = "reproduced"
    source: Source = "printed"
    right: float = float("nan")
    right_source: Source | Literal[""] = ""

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
    source: Source = "printed",
) -> list[PaperNumber]:
    """Return the rows of numbers that are reproduced where they agree to a relative or an absolute tolerance.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        The paper's, and as computed here; as many as names.
    unit : str
        Of all of them.
    relative : float
        Largest difference that agrees, as part of the paper's number.
    absolute : float
        The same in the unit; the larger of the two tolerances counts.
    reason : str
        Why a number is not reproduced; it stands at those rows only.
    recorded : str
        The status that was found when the paper was examined.
    source : str
        Where the paper's numbers are from.
    """
    rows = []
    for name, theirs, value in zip(names, paper, ours, strict=True):
        agrees = _agrees(float(value), theirs, relative, absolute)
        status: Status = "reproduced" if agrees else "not reproduced"
        rows.append(PaperNumber(name, theirs, float(value), unit, status, "" if agrees else reason, recorded, source))
    return rows


def together(rows: list[PaperNumber], reason: str) -> list[PaperNumber]:
    """Return rows that are one finding: as they are where all agree, and otherwise none reproduced.

    Parameters
    ----------
    rows : list of PaperNumber
        As ``compare`` gives them.
    reason : str
        Why they are not reproduced; it stands at all rows then.
    """
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
    right_source: Source,
    source: Source = "printed",
    relative: float = 0.0,
    absolute: float = 0.0,
) -> list[PaperNumber]:
    """Return the rows of numbers in which the paper is wrong, for a reason that makes ours the right ones.

    Where ours does not agree to what is right, the reason does not hold and the row is not reproduced. Where the right
    ones are our own earlier results, that ours agree tells only that nothing has changed here since.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        The paper's, and as computed here; as many as names.
    unit : str
        Of all of them.
    reason : str
        What is wrong in the paper.
    right : sequence of float
        What ours must agree with for the reason to hold; as many as names.
    right_source, source : str
        Where the right numbers are from, and the paper's.
    relative : float
        Largest difference of ours from what is right, as part of the latter.
    absolute : float
        The same in the unit; the larger of the two tolerances counts.
    """
    rows = []
    for name, theirs, value, true in zip(names, paper, ours, right, strict=True):
        status: Status = "paper in error" if _agrees(float(value), true, relative, absolute) else "not reproduced"
        rows.append(
            PaperNumber(
                name, theirs, float(value), unit, status, reason, "paper in error", source, float(true), right_source
            )
        )
    return rows


def _agrees(value: float, to: float, relative: float, absolute: float) -> bool:
    return abs(value - to) <= max(absolute, relative * abs(to))
