"""What of the papers is compared with nothing, and what the docs say of it."""

import runpy
from pathlib import Path

import pytest

from tam_validation.papers import PAPERS
from tam_validation.papers.printed import not_compared

BENCHMARKS = Path(__file__).parents[3] / "benchmarks"


@pytest.mark.parametrize("paper", PAPERS)
def test_each_item_has_one_place_and_a_reason(paper):
    """No item stands there without a reason."""
    items = not_compared(paper)
    assert items
    assert all(item.startswith(("Table", "Fig", "Section")) and reason for item, reason in items.items())


def test_the_page_is_that_of_code_and_results():
    """After a change of the papers, run ``tam reproduce all`` and ``python benchmarks/list_papers.py``."""
    page = (BENCHMARKS / "papers.md").read_text(encoding="utf-8")
    names = runpy.run_path(str(BENCHMARKS / "list_papers.py"))
    assert names["with_tables"](page) == page
    assert all(page.count(f"\n| `{paper}` |") == 1 for paper in PAPERS)
