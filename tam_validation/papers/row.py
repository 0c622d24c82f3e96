"""One number of a paper, the same number in many simulations of it, and the verdict."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal

import numpy as np

from tam_calibration.model.units import FloatArray
from tam_validation.papers.printed import printed_in

Status = Literal["reproduced", "not reproduced", "paper in error"]
Draws = Mapping[str, FloatArray]
"""What the simulations of a paper give, (seeds, n) by the names of its findings."""

_OUTSIDE = 0.025
"""Part of another seed's numbers that may lie below the range, and above it: together 5 %."""

EACH = {
    "sensors": tuple(f"sensor {number}" for number in range(1, 5)),
    "instruments": (*(f"sensor {number}" for number in range(1, 5)), "platform"),
    "components": ("Bxx", "Bxy", "Bxz", "Byx", "Byy", "Byz"),
    "five": ("Bxx", "Bxy", "Bxz", "Byy", "Byz"),
    "axes": ("x", "y", "z", "r"),
}
"""What the numbers of a finding are of, by the words of the papers' files."""


@dataclass(frozen=True, eq=False)
class PaperNumber:
    """A number of a paper, printed or not, and what its simulation gives here.

    Parameters
    ----------
    name, unit : str
        Where it stands in the paper, what it is, and its unit.
    paper : float
        The paper's.
    draws : (S,) array
        Ours, one for each seed.
    half_unit : float
        Half a unit of the last digit that the paper has.
    source : str
        ``printed``, ``derived from printed numbers`` or ``said in words``.
    note : str
        What ours is from, or what is wrong in the paper.
    right : float
        What follows from theory, or from numbers that the paper prints elsewhere, where these differ; else NaN.
    right_source : str
        Which of the two; empty where there is none.
    """

    name: str
    unit: str
    paper: float
    draws: FloatArray
    half_unit: float = 0.0
    source: str = "printed"
    note: str = ""
    right: float = float("nan")
    right_source: str = ""

    @property
    def ours(self) -> float:
        """The median over the seeds."""
        return float(np.median(self.draws))

    @cached_property
    def range(self) -> tuple[float, float]:
        """The 95 % range: where another seed's number lies in 95 of 100 cases, widened by the rounding of the paper's.

        It is taken between two of the S numbers in order, the k-th from either end, where k/(S + 1) is no more than
        2.5 %: of 40 seeds the smallest and the largest. That assumes no distribution; fewer than 39 seeds contain less.
        """
        ordered = np.sort(self.draws)
        outside = max(1, int(_OUTSIDE * (len(ordered) + 1)))
        return float(ordered[outside - 1] - self.half_unit), float(ordered[-outside] + self.half_unit)

    @property
    def status(self) -> Status:
        """Whether the range contains the paper's number, or only what is right."""
        low, high = self.range
        # Rounding of the numbers themselves must not decide.
        slack = 1e-9 * max(abs(low), abs(high))
        if low - slack <= self.paper <= high + slack:
            return "reproduced"
        return "paper in error" if low - slack <= self.right <= high + slack else "not reproduced"


def rows_of(paper: str, draws: Draws) -> list[PaperNumber]:
    """Return the numbers of a paper with ours, in the order of its file.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    draws : mapping
        Of its simulations.
    """
    findings: dict[str, dict[str, Any]] = printed_in(paper)["findings"]
    return [row for name, finding in findings.items() for row in _rows(name, finding, draws)]


def _rows(name: str, finding: dict[str, Any], draws: Draws) -> Iterator[PaperNumber]:
    labels = [EACH[each] if isinstance(each, str) else each for each in finding.get("each", [])]
    names = [", ".join((name, *words)) for words in product(*labels)]
    count = len(names)
    printed = np.ravel(finding["paper"]).astype(float)
    of_each = count // len(labels[0]) if labels else 1
    units = np.repeat(finding["unit"], 1 if isinstance(finding["unit"], str) else of_each)
    decimals = np.repeat(finding.get("decimals", np.inf), 1 if np.isscalar(finding.get("decimals", 0)) else of_each)
    half_units = np.broadcast_to(finding.get("half_unit", 0.5 * 10.0**-decimals), count)
    right = finding.get("right", np.nan)
    right = draws[right_name(name)][0] if right == "by simulation" else np.broadcast_to(right, count)
    same = (finding.get("source", "printed"), finding.get("note", ""))
    for index, unit in enumerate(np.broadcast_to(units, count)):
        better = (float(right[index]), finding.get("right_source", ""))
        rounding = float(half_units[index])
        ours = draws[name][:, index]
        yield PaperNumber(names[index], str(unit), float(printed[index]), ours, rounding, *same, *better)


def right_name(finding: str) -> str:
    """Return by which name a simulation gives what is right of a finding."""
    return f"{finding}, right"
