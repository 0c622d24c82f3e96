"""The sizes that Wu's set-up implies."""

import pytest

from tam_validation.papers import wu2025
from tam_validation.papers.wu2025 import implied_rows


def test_the_site_is_as_printed_but_for_a_minute(wu2025_sweeps):
    """H and Z give the printed intensity, and an inclination of 62°17′."""
    intensity, inclination = implied_rows(wu2025_sweeps, 1.0)[:2]
    assert (intensity.status, inclination.status) == ("reproduced", "paper in error")
    assert inclination.right == pytest.approx(62 + 17 / 60)


def test_sizes_are_reproduced_and_can_be_missed(wu2025_sweeps, monkeypatch):
    """Six sizes of Figs. 5, 7 and 9; with another noise than theirs none is reproduced."""
    sizes = [row for row in implied_rows(wu2025_sweeps, 5.0) if "size of" in row.name]
    assert len(sizes) == 6 and {row.source for row in sizes} == {"derived from printed numbers"}
    assert {row.status for row in sizes} == {"reproduced"}
    monkeypatch.setattr(wu2025, "_NOISE_T", 1.1e-9)
    assert {row.status for row in implied_rows(wu2025_sweeps, 5.0) if "size of" in row.name} == {"not reproduced"}
