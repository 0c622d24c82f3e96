import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.units import to_degrees, to_nanotesla
from tam_validation.papers import chi2017


@pytest.fixture(scope="module")
def rows():
    """Return the numbers of the paper that are compared, by name."""
    return {row.name: row for row in chi2017.results()}


def test_every_number_of_the_simulation_is_there(rows):
    """One sign, 24 + 12 + 27 numbers of Table 2, 4 intensities, 30 of Table 3, and three of the frame."""
    assert len(rows) == 1 + 24 + 12 + 27 + 4 + 30 + 3


def test_kept_results_have_the_verdicts_of_the_code(rows, kept_verdicts, verdicts):
    """After a change of the rows, run ``tam reproduce chi2017``."""
    assert kept_verdicts("chi2017") == verdicts(rows.values())


def test_table_2_is_reproduced(rows):
    """C⁻¹ and R agree to 2e-4 and b to 2 nT with the sign of ψ of sensor 1 mended."""
    table = [row for name, row in rows.items() if name.startswith("Table 2")]
    assert {row.status for row in table} == {"reproduced"}
    assert max(abs(row.ours - row.paper) for row in table if row.unit == "1") < 2e-4
    assert max(abs(row.ours - row.paper) for row in table if row.unit == "nT") < 2


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


def test_residuals_are_reproduced_but_for_what_hangs_on_the_attitudes(rows):
    """After calibration intensity and tensor are as printed; before it they hang on attitudes that are not printed."""
    left = [name for name, row in rows.items() if row.status == "not reproduced"]
    assert len(left) == 15
    assert all("actual" in name for name in left)


def test_soft_iron_turns_the_frame_of_sensor_1():
    """The frame of the Cholesky factor is turned by (-8.2, -14.5, -22.0) degrees from the platform."""
    turn = to_degrees(chi2017.true_errors().misalignment[0])
    assert_allclose(turn, [-8.2, -14.5, -22.0], atol=0.05)
