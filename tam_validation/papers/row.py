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
    right: Sequence[float] | FloatArray | None = None,
    right_source: Source | Literal[""] = "",
) -> list[PaperNumber]:
    """Return the rows of numbers that agree to a relative or an absolute tolerance with the paper's, or the right ones.

    Where numbers in which the paper is wrong are not those that are right, the reason does not hold and the row is not
    reproduced. Where the right ones are our own earlier results, that ours agree tells only that nothing has changed
    here since.

    Parameters
    ----------
    names : iterable of str
        Where each number stands in the paper, and what it is.
    paper, ours : sequence of float
        The paper's, and as computed here; as many as names.
    unit : str
        Of all of them.
    relative : float
        Largest difference that agrees, as part of the number that ours is compared with.
    absolute : float
        The same in the unit; the larger of the two tolerances counts.
    reason : str
        Why a number is not reproduced, where it stands at those rows only, or what is wrong in the paper.
    recorded : str
        The status that was found when the paper was examined, where it is not taken to be in error.
    source : str
        Where the paper's numbers are from.
    right : sequence of float, optional
        What ours must agree with where the paper is taken to be in error; as many as names.
    right_source : str
        Where these are from.
    """
    rows = []
    found: Status = "reproduced" if right is None else "paper in error"
    for name, theirs, value, true in zip(names, paper, ours, paper if right is None else right, strict=True):
        agrees = abs(float(value) - true) <= max(absolute, relative * abs(true))
        status: Status = found if agrees else "not reproduced"
        why = "" if status == "reproduced" else reason
        better = float("nan") if right is None else float(true)
        expected = recorded if right is None else found
        number = float(value), unit, status, why, expected, source, better, right_source
        rows.append(PaperNumber(name, theirs, *number))
    return rows


def together(rows: list[PaperNumber]) -> list[PaperNumber]:
    """Return rows that are one finding: as they are where all agree, and otherwise none reproduced.

    Parameters
    ----------
    rows : list of PaperNumber
        As ``compare`` gives them.
    """
    failed = [row for row in rows if row.status != "reproduced"]
    return [replace(row, status="not reproduced", reason=failed[0].reason) for row in rows] if failed else rows
