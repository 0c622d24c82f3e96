"""Channels that bleed into each other."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.lags import Crosstalk
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

EFFECT = Crosstalk()
LATE = {"late_y_s": 0.05}


def test_the_reading_before_is_what_a_multiplexer_held(turning):
    """A capacitor that keeps a part of the reading before adds that, less the same part of the present one."""
    covariates = turning()
    other = covariates.field_T[:, 1]
    fitted = FittedEffect("crosstalk", LATE, (Contribution(0, 2, "from y", {"bleed": 0.01}),))
    added = EFFECT.signal(covariates, fitted)
    assert_allclose(added[1:, 2], 0.01 * (other[:-1] - other[1:]), atol=1e-15)
    assert not np.delete(added, 2, axis=1).any()


@pytest.mark.parametrize("late_s", [0.05, 0.4])
def test_before_the_record_and_a_hole_the_array_turned_as_evenly_as_then(turning, late_s):
    """An array that turns evenly through the field: what bleeds is known from the first sample on."""
    axis = np.cross([12, 18, -45], [1, 0, 0]) / np.linalg.norm([45, 18])
    evenly = Rotation.from_rotvec(np.outer(0.04 * np.arange(1200), axis)).as_quat()
    whole = turning(attitude=evenly)
    kept = np.r_[8:400, 600:1200]
    ours, theirs = (
        EFFECT.terms(covariates, {"late_y_s": late_s})[0].features[:, 0] for covariates in (whole.take(kept), whole)
    )
    assert_allclose(ours, theirs[kept], atol=1e-4 * np.abs(theirs).max())


def test_each_axis_may_bleed_in_the_windows_of_a_law(turning):
    """One shape for each axis of the array, all in the same windows."""
    shapes = EFFECT.shapes_at([1.0, 2.0, 4.0], turning())
    windows = {"on_1_s": 1.0, "off_1_s": 2.0, "on_2_s": 4.0}
    assert shapes == [{f"late_{axis}_s": 0.0, **windows} for axis in "xyz"]


def test_poses_show_no_delay(turning, left_by):
    """Without motion there is no reading before that differs."""
    poses = turning(samples=300, attitude=np.random.default_rng(1).normal(size=(300, 4)))
    assert not [one for one in EFFECT.shapes(poses, left_by(EFFECT, poses, LATE)) if "on_1_s" not in one]


def test_a_shape_that_says_nothing_of_the_channel_is_refused(turning):
    """As a file may hold one, with a sentence that names what is missing."""
    part = Contribution(0, 2, "from y", {"bleed": 0.01})
    with pytest.raises(InputError, match="crosstalk needs the value 'late_x_s or late_y_s or late_z_s'"):
        EFFECT.signal(turning(), FittedEffect("crosstalk", {}, (part,)))


def test_few_samples_are_told(turning):
    """A dozen hold neither a motion nor windows."""
    assert "12 samples are too few" in EFFECT.obstacle(turning(samples=12))
    assert EFFECT.obstacle(turning()) is None


def test_one_to_ten_steps_late_are_tried(turning, left_by):
    """The channel before, and a queue of usual length; between them no more than twice as late as the one before."""
    covariates = turning()
    shapes = EFFECT.shapes(covariates, left_by(EFFECT, covariates, LATE))
    late = np.array([shape["late_x_s"] for shape in shapes if "late_x_s" in shape]) / covariates.step_s
    assert_allclose([late.min(), late.max()], [1, 10])
    assert (late[1:] <= 2 * late[:-1]).all()
