"""What is told of an effect's shape after the joint fit is what the recording determines, not what rounding does."""

import numpy as np
import pytest

from tam_calibration.effects.courses import TemperatureDrift
from tam_calibration.gap.hypothesis import Part
from tam_calibration.gap.joint import Joint

SLOPE_T_PER_K = 30e-9
KEYS = ((1, 0, "offset"),)


def joint_with(run, shape):
    """Return the joint fit of a run of two sensors in which an axis drifts with the temperature, at a shape."""
    made = run(400, 2)
    made = made.with_row(3, SLOPE_T_PER_K * (made.recording.temperature_C - 20))
    part = Part(TemperatureDrift(), {**shape, "reference_C": 20.0}, KEYS, np.full(1, SLOPE_T_PER_K))
    return Joint(made.model(parts=(part,)), (tuple(shape),))


@pytest.mark.parametrize(("share", "is_told"), [(0.5, False), (0.45, True)])
def test_what_makes_no_difference_has_no_standard_error(run, share, is_told):
    """Of two layers alike neither share matters, but for rounding; of unlike ones it does."""
    [effect] = joint_with(run, {"time_constant_s": 5.0, "inner_share": share}).effects
    assert ("inner_share" in effect.shape_errors) == is_told
    assert 0 < effect.shape_errors["time_constant_s"] < 10


def test_it_leaves_the_others_as_they_are_without_it(run):
    """A time constant is as certain as where the share is not free, to all digits."""
    [of_two] = joint_with(run, {"time_constant_s": 5.0, "inner_share": 0.5}).effects
    joint = joint_with(run, {"time_constant_s": 5.0, "inner_share": 0.5})
    [of_one] = Joint(joint.model, (("time_constant_s",),)).effects
    assert of_two.shape_errors["time_constant_s"] == pytest.approx(of_one.shape_errors["time_constant_s"], rel=1e-9)
