import numpy as np
import pytest
from numpy.testing import assert_allclose


@pytest.fixture(scope="module")
def rows(simulated_numbers):
    """Return the numbers of the paper by name."""
    return simulated_numbers("li2018b")


def test_every_number_is_there(rows):
    """Tables 1 to 4 have 36 + 9, 16, 24 + 8 and 18 numbers, the abstract 2, Tables 5 to 7 20, 12 + 10 and 12."""
    assert len(rows) == 36 + 9 + 2 + 16 + 24 + 8 + 18 + 20 + 12 + 10 + 12
    assert np.isfinite([row.ours for row in rows.values()]).all()


def test_kept_results_are_those_of_the_code(rows, kept_numbers):
    """After a change of the rows, run ``tam reproduce li2018b``."""
    assert {name: row["status"] for name, row in kept_numbers("li2018b").items()} == {
        name: row.status for name, row in rows.items()
    }


def test_before_and_first_order_agree_to_a_ten_thousandth(rows):
    """What does not hang on the noise is met to 1e-4."""
    firm = [rows[name] for name in rows if name.startswith(("Table 2, TMI, before", "Table 2, TMI, method of [9]"))]
    firm += [rows[name] for name in rows if name.startswith("Table 4, before")]
    assert len(firm) == 4 + 4 + 6
    assert_allclose([row.ours / row.paper for row in firm], 1.0, rtol=1e-4)


def test_the_calibrated_row_was_divided_by_another_baseline(rows):
    """Each tensor component after calibration is 0.8 of ours: 0.4 m by 0.5 m."""
    calibrated = [row for name, row in rows.items() if name.startswith("Table 4, calibrated")]
    assert_allclose([row.ours / row.paper for row in calibrated], 1.25, rtol=1e-4)
    assert {row.status for row in calibrated} == {"paper in error"}


def test_one_turn_determines_less_than_claimed(rows):
    """The paper claims 45 parameters from one turn, and nine of a sensor from ten samples; 32 and 5 are determined."""
    turn = rows["Abstract, parameters that one turn determines"]
    ten = rows["Abstract, parameters that ten samples of one turn determine of a sensor"]
    assert [(row.paper, row.ours, row.status) for row in (turn, ten)] == [
        (45, 32, "paper in error"),
        (9, 5, "paper in error"),
    ]


def test_as_published_ten_samples_give_no_calibration(simulated_numbers):
    """What hangs on it has no number; the rest stays."""
    published = simulated_numbers("li2018b", 2, as_published=True)
    assert np.isnan(published["Table 1, φ, sensor 1"].ours)
    assert np.isnan(published["Table 4, aligned by 3 samples, Bxx"].ours)
    assert np.isfinite(published["Table 2, TMI, before, sensor 1"].ours)
