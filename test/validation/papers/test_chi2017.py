import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.units import to_degrees, to_nanotesla
from tam_validation.papers import chi2017


@pytest.fixture(scope="module")
def rows(simulated_numbers):
    """Return the numbers of the paper by name."""
    return simulated_numbers("chi2017")


def test_every_number_is_there(rows):
    """One sign, 24 + 12 + 27 numbers of Table 2, 4 intensities, 30 of Table 3, three of the frame and 5 of Table 4."""
    assert len(rows) == 1 + 24 + 12 + 27 + 4 + 30 + 3 + 5
    assert np.isfinite([row.ours for row in rows.values()]).all()


def test_kept_results_are_those_of_the_code(rows, kept_numbers):
    """After a change of the rows, run ``tam reproduce chi2017``."""
    assert {name: row["status"] for name, row in kept_numbers("chi2017").items()} == {
        name: row.status for name, row in rows.items()
    }


def test_table_3_before_calibration_is_reproduced(rows):
    """With a uniform angle between the field and the x axis all 15 numbers come out."""
    actual = [row for name, row in rows.items() if name.startswith("Table 3, actual")]
    assert len(actual) == 15 and {row.status for row in actual} == {"reproduced"}


def test_the_sign_is_found_from_table_2(rows):
    """The ψ of sensor 1 that makes the printed C⁻¹ is the printed one reversed."""
    row = rows["Table 1, ψ, sensor 1"]
    assert row.ours == pytest.approx(-row.paper, abs=3e-4) and row.ours != row.right
    assert (row.status, row.right_source) == ("paper in error", "derived from printed numbers")


def test_the_printed_sign_cannot_be_right():
    """With ψ of sensor 1 as printed the combined bias is 69 nT off."""
    printed = chi2017.NON_ORTHOGONALITY.copy()
    printed[0, 2] *= -1
    off = to_nanotesla(chi2017.true_errors(printed).bias_T) - chi2017.COMBINED_BIAS_NT
    assert np.abs(off[0, 1]) == pytest.approx(69, abs=1)


def test_as_published_table_2_does_not_come_out(simulated_numbers):
    """The sign of Table 1 gives another C⁻¹ and b of sensor 1, by many times what the noise makes."""
    published = simulated_numbers("chi2017", 5, as_published=True)
    assert published["Table 2, b, sensor 1, y"].status == "not reproduced"
    assert published["Table 2, C⁻¹, sensor 1, 23"].status == "not reproduced"


def test_soft_iron_turns_the_frame_of_sensor_1():
    """The frame of the Cholesky factor is turned by (-8.2, -14.5, -22.0) degrees from the platform."""
    turn = to_degrees(chi2017.true_errors().misalignment[0])
    assert_allclose(turn, [-8.2, -14.5, -22.0], atol=0.05)
