"""What each paper prints of what is reproduced, and what of it is compared with nothing: a YAML file for each."""

from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from tam_calibration.files.yaml_document import mapping_in
from tam_calibration.model.units import FloatArray
from tam_validation.papers.row import PaperNumber, compare


@cache
def printed_in(paper: str) -> dict[str, Any]:
    """Return the tables that a paper prints.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    with mapping_in(Path(__file__).with_name(f"{paper}.yaml")) as content:
        return content


def not_compared(paper: str) -> dict[str, str]:
    """Return the tables and figures of a paper that are not simulated, or not compared, each with the reason.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    reasons: dict[str, str] = printed_in(paper)["not_compared"]
    return reasons


def finding(
    paper: str,
    name: str,
    ours: Sequence[float] | FloatArray,
    /,
    *,
    slack: float = 1.0,
    told: dict[str, float | str] | None = None,
    **given: Any,
) -> list[PaperNumber]:
    """Return the rows of what a paper prints or says, as its file describes them: the arguments of ``compare``.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    name : str
        Of the finding.
    ours : sequence of float
        As computed here.
    slack : float
        By how much tolerances are wider than the file says.
    told : dict, optional
        What is filled into the reason.
    **given : object
        Arguments that the file does not have.
    """
    said = given | printed_in(paper)["findings"][name]
    said["reason"] = said.get("reason", "").format(**told or {})
    for tolerance in said.keys() & {"relative", "absolute"}:
        said[tolerance] *= slack
    return compare(ours=ours, **said)


def reason_of(paper: str, name: str, **values: float | str) -> str:
    """Return why numbers of a paper are not reproduced, values filled in.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    name : str
        Of the reason.
    **values : object
        What is filled in.
    """
    reason: str = printed_in(paper)["reasons"][name]
    return reason.format(**values)
