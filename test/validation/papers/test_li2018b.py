import pytest
from numpy.testing import assert_allclose

from tam_validation.papers import li2018b


@pytest.fixture(scope="module")
def rows():
    """Return the numbers of the paper that are compared, by name."""
    return {row.name: row for row in li2018b.results()}


def test_every_number_of_the_simulation_is_there(rows):
    """Table 1 has 36, Table 2 has 16, Table 3 has 24, Table 4 has 18 numbers; one is the abstract's claim."""
    assert len(rows) == 36 + 16 + 24 + 18 + 1


def test_kept_results_have_the_verdicts_of_the_code(rows, kept_verdicts, verdicts):
    """After a change of the rows, run ``tam reproduce li2018b``."""
    assert kept_verdicts("li2018b") == verdicts(rows.values())


def test_before_and_first_order_agree_to_a_ten_thousandth(rows):
    """What does not hang on the noise is met to 1e-4."""
    firm = [row for name, row in rows.items() if "before" in name or "method of [9]" in name]
    assert len(firm) == 4 + 6 + 4
    assert_allclose([row.ratio for row in firm], 1.0, rtol=1e-4)


def test_what_is_not_reproduced_is_one_row(rows):
    """Only the row of reference [10] is left without an explanation of its numbers."""
    assert {name.split(", sensor")[0] for name, row in rows.items() if row.status == "not reproduced"} == {
        "Table 2, TMI, method of [10]"
    }


def test_the_calibrated_row_was_divided_by_another_baseline(rows):
    """Each tensor component after calibration is 0.8 of ours: 0.4 m by 0.5 m."""
    calibrated = [row for name, row in rows.items() if name.startswith("Table 4") and "calibrated" in name]
    assert_allclose([row.ratio for row in calibrated], 1.25, rtol=1e-4)
    assert {row.status for row in calibrated} == {"paper in error"}


def test_one_turn_determines_less_than_claimed(rows):
    """The paper claims 45 parameters from one turn; 32 are determined."""
    row = rows["Abstract, parameters that one turn determines"]
    assert (row.paper, row.ours, row.status) == (45, 32, "paper in error")
    assert (row.source, row.right_source) == ("said in words", "theory")
