"""Errors in another frame: the derivatives are those of the errors."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.prior import turned
from tam_calibration.model.sensor_errors import SensorErrors

STEP = 1e-6


@pytest.fixture(scope="module")
def errors():
    """Return the errors of three sensors."""
    vector = np.repeat([1.0, 0.0], [3, 9]) + 0.05 * np.random.default_rng(3).normal(size=(3, 12))
    return SensorErrors.from_vector(vector)


def test_the_derivative_by_the_errors(errors):
    """Of each error of each sensor."""
    rotation = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix()
    _, derivative = turned(errors, rotation)
    for index in range(36):
        step = np.zeros((3, 12))
        step.flat[index] = STEP
        ends = [turned(SensorErrors.from_vector(errors.to_vector() + sign * step), rotation)[0] for sign in (1, -1)]
        expected = (ends[0].to_vector() - ends[1].to_vector()).ravel() / (2 * STEP)
        assert_allclose(derivative[:, index], expected, atol=1e-6)


def test_the_derivative_by_a_further_turn(errors):
    """The turn acts before the rotation on the right of the matrices."""
    rotation = Rotation.from_rotvec([0.1, -0.2, 0.3])
    _, derivative = turned(errors, rotation.as_matrix())
    for axis, turn in enumerate(STEP * np.eye(3)):
        ends = [
            turned(errors, (Rotation.from_rotvec(sign * turn) * rotation).as_matrix())[0].to_vector()
            for sign in (1, -1)
        ]
        assert_allclose(derivative[:, 36 + axis], (ends[0] - ends[1]).ravel() / (2 * STEP), atol=1e-6)
