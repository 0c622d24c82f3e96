"""Numbers of the papers and their 95 % ranges."""

import numpy as np
import pytest

from tam_validation.papers.row import PaperNumber, rows_of


def number(paper, draws, **more):
    """Return a number of a paper beside draws of ours."""
    return PaperNumber("Table 1", "nT", paper, np.array(draws, dtype=float), **more)


@pytest.mark.parametrize("seeds", [40, 200])
def test_the_range_holds_another_seed_in_95_of_100_cases(seeds):
    """Whatever the distribution: normal numbers, and such of long tails."""
    rng = np.random.default_rng(1)
    for draw in (rng.normal, rng.standard_cauchy):
        inside = [number(one, draws).status == "reproduced" for one, *draws in draw(size=(4000, seeds + 1))]
        assert np.mean(inside) == pytest.approx(0.951, abs=0.012)


def test_the_range_is_widened_by_the_rounding_of_print():
    """A number of one decimal may be half a unit of it away."""
    assert number(1.3, [1.0, 1.2, 1.26], half_unit=0.05).status == "reproduced"
    assert number(1.3, [1.0, 1.2, 1.24], half_unit=0.05).status == "not reproduced"
    assert number(1.3, [1.3, 1.3, 1.3]).status == "reproduced"


def test_the_paper_is_in_error_where_only_the_right_number_is_within():
    """A number that is itself within is reproduced, and one without a right one is not reproduced."""
    assert number(0.0, [0.9, 1.1], right=1.0, right_source="theory").status == "paper in error"
    assert number(1.0, [0.9, 1.1], right=1.05, right_source="theory").status == "reproduced"
    assert number(0.0, [0.9, 1.1], right=2.0, right_source="theory").status == "not reproduced"
    assert number(0.0, [np.nan, np.nan]).status == "not reproduced"


def test_ours_is_the_median():
    """One odd seed does not move it."""
    assert number(1.0, [1, 2, 90]).ours == 2


def test_findings_become_rows(monkeypatch):
    """Names, units and decimals go from the file to the rows, tables row by row."""
    finding = {
        "each": [["θ", "i"], "axes"],
        "unit": ["°", "nT"],
        "decimals": [1, 0],
        "paper": np.arange(8).reshape(2, 4),
    }
    monkeypatch.setattr("tam_validation.papers.row.printed_in", lambda paper: {"findings": {"Table 1": finding}})
    rows = rows_of("any", {"Table 1": np.arange(8.0) + np.zeros((2, 1))})
    assert [row.name for row in rows[:2]] == ["Table 1, θ, x", "Table 1, θ, y"]
    assert [row.unit for row in rows] == ["°"] * 4 + ["nT"] * 4
    assert [row.half_unit for row in rows] == [0.05] * 4 + [0.5] * 4
    assert {row.status for row in rows} == {"reproduced"}
