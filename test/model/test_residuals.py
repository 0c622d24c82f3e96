"""The floor of the residuals is what noise alone leaves of them: draws of it, corrected with the true errors."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals, noise_floor


@pytest.fixture(scope="module")
def uneven():
    """Return errors whose axes differ by a factor of three: only the mean over all directions then is the floor."""
    errors = SensorErrors.none(4)
    return replace(errors, scale_factor=errors.scale_factor * np.array([0.5, 1.0, 1.5]))


@pytest.mark.parametrize("scalar_noise_T", [0.0, 3e-9])
def test_the_floor_is_what_noise_alone_leaves(uneven, scalar_noise_T):
    """Of 40 000 directions all over the sphere, to a per cent."""
    generator = np.random.default_rng(4)
    array = Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=scalar_noise_T)
    array = replace(array, vector_noise_T=np.array([1e-9, 2e-9, 3e-9, 4e-9]))
    direction = generator.normal(size=(40_000, 3))
    field = 5e-5 * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    noise = array.vector_noise_T[:, None] * generator.normal(size=(len(field), 4, 3))
    scalar = 5e-5 + scalar_noise_T * generator.normal(size=len(field))
    recording = Recording(np.arange(len(field)) / 100, uneven.distort(field) + noise, scalar)
    left, floor = measure_residuals(uneven, array, recording, 5e-5), noise_floor(uneven, array, scalar_noise_T)
    assert_allclose(left.sensor_intensity_T, floor.sensor_intensity_T, rtol=0.02)
    assert left.center_intensity_T == pytest.approx(floor.center_intensity_T, rel=0.02)
    assert_allclose(left.tensor_T_per_m, floor.tensor_T_per_m, rtol=0.02)
