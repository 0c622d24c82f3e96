"""The ledger of the constants of the diagnosis: what it finds, how it sorts, and that its page is of this code."""

import ast
import re
import runpy
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
LEDGER = runpy.run_path(str(ROOT / "benchmarks" / "constants.py"))


@pytest.fixture(scope="module")
def found():
    """Return the constants of the code."""
    return LEDGER["find_constants"]()


def test_every_constant_is_read(found):
    """A number that no code reads decides nothing and is to be deleted."""
    assert [one.key for one in found if not one.is_read] == []


def test_the_page_lists_the_constants_of_this_code(found):
    """After a change of a constant, run ``python benchmarks/gap_constants.py --quick``."""
    page = (ROOT / "benchmarks" / "gap_constants.md").read_text(encoding="utf-8")
    listed = re.findall(r"^\| `([^`]+)` \| ([^|]*) \|", page, re.MULTILINE)
    stated = {(key, value) for key, value in listed if "." in key}
    assert stated == {(one.key, one.told) for one in found}


@pytest.mark.parametrize(
    ("use", "is_compared"),
    [
        ("return x > LEVEL", True),
        ("least = 2 * LEVEL\n    return x > least", True),
        ("return x > level(x)", True),
        ("return x * LEVEL", False),
        ("return LEVEL > 0", False),
        ("return x in LEVEL", False),
    ],
)
def test_what_is_compared_is_told_from_what_is_used_otherwise(use, is_compared):
    """Also by way of a local name or a function; a sign and a membership are no comparison of sizes."""
    source = f"def level(x):\n    return LEVEL * x\n\n\ndef decides(x):\n    {use}\n"
    assert (("a", "LEVEL") in LEDGER["_compared"]({"a": ast.parse(source)})) == is_compared


def test_parts_near_one_are_scaled_by_what_they_lack():
    """Twice a part of 0.97 would be more than all of it."""
    near = LEDGER["Constant"]("tam_calibration.gap.x", "PART", 0.97, "", "decision", True)
    assert near.scaled(2.0) == pytest.approx(0.94)
    assert near.scaled(0.5) == pytest.approx(0.985)
