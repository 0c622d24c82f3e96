import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.units import to_degrees
from tam_calibration.validation.papers import li2018a


@pytest.fixture(scope="module")
def rows():
    """Return every number of the paper beside ours."""
    return {row.name: row for row in li2018a.results()}


def test_every_number_of_the_simulation_is_there(rows):
    """Table 1 has 16, Table 2 has 24, Table 3 has 48 numbers; three are of the frame."""
    assert len(rows) == 16 + 24 + 48 + 3


def test_all_but_the_frame_is_reproduced(rows):
    """The paper is wrong on the frame only."""
    wrong = [name for name, row in rows.items() if row.status != "reproduced"]
    assert len(wrong) == 3
    assert all("turn of the artificial vector" in name for name in wrong)


def test_before_and_first_order_agree_to_a_ten_thousandth(rows):
    """What does not hang on the noise is met to 1e-4."""
    firm = [row for name, row in rows.items() if "before" in name or name.startswith("Table 1, TMI, Zhang")]
    assert len(firm) == 4 + 6 + 4
    assert_allclose([row.ratio for row in firm], 1.0, rtol=1e-4)


def test_the_artificial_frame_is_turned_from_the_platform():
    """The artificial vector is turned by 1.21, 2.04 and -0.85 degrees."""
    turn = to_degrees(li2018a.artificial_frame(li2018a.set_up()))
    assert_allclose(turn, [1.21, 2.04, -0.85], atol=0.005)


def test_errors_and_table_are_inverse():
    """The table of the errors of the preset is the preset."""
    assert_allclose(li2018a.table_of(li2018a.errors_of(li2018a.PRESET)), li2018a.PRESET, rtol=1e-12)


def test_poses_have_one_intensity():
    """Turned about three axes the field keeps its intensity of 55 000 nT."""
    assert_allclose(np.linalg.norm(li2018a.set_up().field_T, axis=1), 55e-6, rtol=1e-12)
