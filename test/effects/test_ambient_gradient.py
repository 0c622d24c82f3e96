"""What a gradient of the world adds in the array frame, and taking it off again."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.surroundings import (
    AmbientGradient,
    gradient_field,
    require_attitude,
    turned,
    without_gradient,
)
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, UNIT_TENSORS, Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, Contribution, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel

GRADIENT = 1e-9 * np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])


@pytest.fixture(scope="module")
def scenario():
    """Return Wu's array without noise in a gradient, with attitude, its scalar magnetometer away from the centre."""
    wu = read_scenario("wu_table_1")
    array = replace(wu.array, vector_noise_T=None, scalar_noise_T=None, scalar_position_m=np.array([0.3, -0.2, 0.9]))
    return replace(wu, array=array, attitude=AttitudeChannel(), site_gradient_T_per_m=GRADIENT, sample_count=50)


def test_the_basis_spans_symmetric_trace_free_tensors():
    """Five components make any such tensor, and are its own."""
    assert_allclose(np.tensordot(GRADIENT[TENSOR_ROWS, TENSOR_COLUMNS], UNIT_TENSORS, 1), GRADIENT, atol=1e-24)


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


def test_the_effect_is_the_gradient_of_the_fit(turning):
    """Its terms of degree 2 add, at sensors and scalar, what the fit takes off."""
    covariates, weak = turning(samples=60), GRADIENT / 100
    names = ("xx", "xy", "xz", "yy", "yz")
    values = {f"gradient {name}": value for name, value in zip(names, weak[TENSOR_ROWS, TENSOR_COLUMNS], strict=True)}
    fitted = FittedEffect("ambient_gradient", {}, (Contribution(ALL, None, "degree 2", values),))
    rows = np.column_stack([covariates.sensed_T + covariates.errors.bias_T.ravel(), covariates.intensity_T])
    disturbed = AmbientGradient().add(rows, covariates, fitted, np.random.default_rng(1))
    readings = disturbed[:, :-1].reshape(60, -1, 3)
    recording = Recording(covariates.time_s, readings, disturbed[:, -1], attitude=covariates.attitude)
    uniform = without_gradient(recording, covariates.errors, covariates.array, weak)
    assert_allclose(uniform.readings_T.reshape(60, -1), rows[:, :-1], atol=1e-18)
    assert_allclose(uniform.scalar_T, rows[:, -1], rtol=0, atol=1e-13)


def test_a_dipole_at_some_distance_is_within_the_terms(turning):
    """Two metres from a cross of half a metre the degrees 2 to 4 leave a hundredth of its field."""
    covariates = turning(samples=300)
    source, moment = np.array([1.2, 0.9, -1.4]), np.array([2.0, -1.0, 3.0])

    def field(position):
        away = position - source
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        return 1e-7 * (3 * away * (away @ moment)[:, None] / distance**5 - moment / distance**3)

    rotation = Rotation.from_quat(covariates.attitude)
    change = [
        rotation.inv().apply(field(rotation.apply(at)) - field(np.zeros((1, 3)))) for at in covariates.array.positions_m
    ]
    signal = np.einsum("kij,knj->nki", covariates.errors.matrix, change).reshape(300, -1)
    terms = list(AmbientGradient().terms(covariates, {}))
    basis = np.column_stack(
        [term.signal(one, 13)[:, :-1].ravel() for term in terms for one in np.eye(len(term.coefficients))]
    )
    basis = basis / np.abs(basis).max(axis=0)
    left = signal.ravel() - basis @ np.linalg.lstsq(basis, signal.ravel(), rcond=None)[0]
    assert np.linalg.norm(left) < 0.01 * np.linalg.norm(signal)


def test_where_no_gradient_can_be_seen(turning):
    """Neither an array at rest nor a sensor in the centre of rotation shows it."""
    covariates = turning()
    assert AmbientGradient().obstacle(covariates) is None
    rest = turning(attitude=np.tile([0.0, 0.6, 0.0, 0.8], (1200, 1)))
    assert "the attitude changes by" in AmbientGradient().obstacle(rest)
    middle = replace(turning(sensors=1), array=Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))
    assert "centre of rotation" in AmbientGradient().obstacle(middle)
