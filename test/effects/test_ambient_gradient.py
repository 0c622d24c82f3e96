"""What a gradient of the world adds in the array frame, and taking it off again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.ambient_gradient import (
    BASIS,
    COLUMNS,
    ROWS,
    gradient_field,
    require_attitude,
    turned,
    without_gradient,
)
from tam_calibration.files.scenario import read_scenario
from tam_calibration.problems import InputError
from tam_calibration.simulation import simulate
from tam_calibration.simulation.channels import AttitudeChannel

GRADIENT = 1e-9 * np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])


@pytest.fixture(scope="module")
def scenario():
    """Return Wu's array without noise in a gradient, with attitude, its scalar magnetometer away from the centre."""
    wu = read_scenario("wu_table_1")
    array = replace(wu.array, vector_noise_T=None, scalar_noise_T=None, scalar_position_m=np.array([0.3, -0.2, 0.9]))
    return replace(wu, array=array, attitude=AttitudeChannel(), site_gradient_T_per_m=GRADIENT, sample_count=50)


def test_the_basis_spans_symmetric_trace_free_tensors():
    """Five components make any such tensor, and are its own."""
    assert_allclose(np.tensordot(GRADIENT[ROWS, COLUMNS], BASIS, 1), GRADIENT, atol=1e-24)


def test_the_field_is_the_gradient_along_the_world_position():
    """Carried into the world, what is added is G times the sensor's place there."""
    generator = np.random.default_rng(1)
    attitude, positions = generator.normal(size=(20, 4)), generator.normal(size=(5, 3))
    rotation = Rotation.from_quat(attitude)
    field = gradient_field(GRADIENT, attitude, positions)
    for sensor, position in enumerate(positions):
        assert_allclose(rotation.apply(field[:, sensor]), rotation.apply(position) @ GRADIENT, atol=1e-22)


def test_turned_tensors_keep_their_invariants():
    """Eigenvalues do not depend on the attitude."""
    tensors = turned(GRADIENT[None], np.random.default_rng(2).normal(size=(10, 4)))[:, 0]
    assert_allclose(np.linalg.eigvalsh(tensors), np.tile(np.linalg.eigvalsh(GRADIENT), (10, 1)), atol=1e-21)


def test_taken_off_it_leaves_the_recording_of_a_uniform_field(scenario):
    """Readings and scalar away from the centre become those of the same run without a gradient."""
    made = simulate(scenario)
    uniform = without_gradient(made.recording, made.errors, scenario.array, GRADIENT)
    expected = simulate(replace(scenario, site_gradient_T_per_m=None)).recording
    assert np.abs(made.recording.readings_T - expected.readings_T).max() > 1e-8
    assert_allclose(uniform.readings_T, expected.readings_T, rtol=0, atol=1e-18)
    assert_allclose(uniform.scalar_T, expected.scalar_T, rtol=0, atol=1e-18)


def test_samples_without_attitude_are_left_out(scenario):
    """Where the attitude is not known neither is what the gradient adds."""
    recording = simulate(scenario).recording
    attitude = recording.attitude.copy()
    attitude[7] = np.nan
    assert require_attitude(replace(recording, attitude=attitude)).sample_count == 49
    assert require_attitude(recording) is recording


def test_no_attitude_is_told(scenario):
    """Without attitude there is no telling how the gradient turned."""
    recording = replace(simulate(scenario).recording, attitude=None)
    with pytest.raises(InputError, match="the recording has no attitude: record it"):
        without_gradient(recording, scenario.errors, scenario.array, GRADIENT)
