"""What each paper prints, and what of it has no number of ours: a YAML file for each."""

from functools import cache
from pathlib import Path
from typing import Any

from tam_calibration.files.yaml_document import mapping_in


@cache
def printed_in(paper: str) -> dict[str, Any]:
    """Return the content of the file of a paper.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    with mapping_in(Path(__file__).with_name(f"{paper}.yaml")) as content:
        return content


def not_compared(paper: str) -> dict[str, str]:
    """Return the tables and figures of a paper that have no number of ours, each with the reason.

    Parameters
    ----------
    paper : str
        One of ``PAPERS``.
    """
    reasons: dict[str, str] = printed_in(paper)["not_compared"]
    return reasons
