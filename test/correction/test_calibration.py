"""What a calibration says of a recording: residuals, standard errors of its outputs, and their figure."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import inv, norm
from numpy.testing import assert_allclose

from tam_calibration.correction.parts import EffectSize
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

DRAWS = 20_000
SHAPE = {"time_constant_s": 0.0, "reference_C": 20.0}
DRIFT = FittedEffect("temperature_drift", SHAPE, (Contribution(1, 0, "offset", {"offset": 50e-9}),))
"""A drift of 50 nT/K of sensor 2 x."""


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration whose own uncertainty exceeds the noise, and differs from direction to direction."""
    made = calibrate(recording, cross)
    growth = np.tile([60, 5, 1, 30, 20, 10, 90, 20, 1, 5, 30, 10], 4)
    return replace(made, covariance=growth[:, None] * made.covariance * growth)


def test_residuals_are_those_of_the_definition(calibration, recording):
    """|M⁻¹ (y - o)| less the scalar reading for each sensor and the mean of all, and the gradient of the four."""
    series = calibration.residuals(recording)
    errors, baseline = calibration.errors, 0.5
    field = np.stack([(recording.readings_T[:, k] - errors.bias_T[k]) @ inv(errors.matrix[k]).T for k in range(4)], 1)
    assert_allclose(series.sensor_intensity_T, norm(field, axis=2) - recording.scalar_T[:, None], rtol=0, atol=1e-18)
    center = norm(field.mean(axis=1), axis=1) - recording.scalar_T
    assert_allclose(series.center_intensity_T, center, rtol=0, atol=1e-18)
    xz = (field[:, 0, 2] - field[:, 2, 2]) / baseline
    assert_allclose(series.tensor_T_per_m[:, 2], xz, rtol=0, atol=1e-18)
    assert np.sqrt(np.mean(series.sensor_intensity_T**2)) == pytest.approx(1e-9, rel=0.1)


def test_without_a_scalar_the_reference_is_the_fitted_intensity(calibration, recording):
    """The field of the recording swings by 5 nT about it."""
    series = calibration.residuals(replace(recording, scalar_T=None))
    swing = recording.scalar_T - calibration.intensity_T
    assert np.corrcoef(series.center_intensity_T, swing)[0, 1] > 0.98


def test_residuals_are_those_without_effects(calibration, recording):
    """A drift by temperature that the calibration knows leaves no trace."""
    temperature = np.linspace(10.0, 30.0, recording.sample_count)
    known = replace(calibration, effects=(DRIFT,), effect_sizes=(EffectSize(np.zeros(9), np.zeros(9)),))
    readings = recording.readings_T.copy()
    readings[:, 1, 0] += 50e-9 * (temperature - 20.0)
    with_drift = replace(recording, readings_T=readings, temperature_C=temperature)
    expected = calibration.residuals(recording).sensor_intensity_T
    assert_allclose(known.residuals(with_drift).sensor_intensity_T, expected, rtol=0, atol=1e-17)
    assert np.abs(calibration.residuals(with_drift).sensor_intensity_T - expected).max() > 100e-9


@pytest.mark.parametrize("direction", [[1, 0, 0], [-0.5, 0.5, np.sqrt(0.5)]])
def test_standard_errors_are_the_scatter_of_the_outputs(calibration, direction):
    """Of arrays drawn from the covariance, in one field, with noise: to three per cent, and unlike their mean."""
    random = np.random.default_rng(5)
    field_T = calibration.intensity_T * np.array(direction)
    value, vector = np.linalg.eigh(calibration.covariance)
    parameters = calibration.errors.to_vector().ravel()
    drawn = parameters + (random.normal(size=(DRAWS, 48)) * np.sqrt(np.maximum(value, 0))) @ vector.T
    true = SensorErrors.from_vector(drawn.reshape(-1, 12))  # of as many sensors as four times the arrays
    readings = (true.matrix @ field_T + true.bias_T).reshape(DRAWS, 4, 3) + 1e-9 * random.normal(size=(DRAWS, 4, 3))
    scatter = calibration.apply(readings).std(axis=0)
    outputs, errors = calibration.apply(calibration.errors.distort(field_T[None]), with_errors=True)
    assert_allclose(outputs[0, :3], field_T, rtol=0, atol=1e-17)
    assert_allclose(errors[0], scatter, rtol=0.03)
    assert np.abs(errors[0] / calibration.output_standard_errors - 1).max() > 0.05


def test_the_mean_square_over_all_directions_is_that_of_the_calibration(calibration):
    """Six fields along the axes have the mean of all directions, for the variance is quadratic in the field."""
    axes = calibration.intensity_T * np.vstack([np.eye(3), -np.eye(3)])
    outputs, errors = calibration.apply(calibration.errors.distort(axes), with_errors=True)
    assert_allclose(np.sqrt((errors**2).mean(axis=0)), calibration.output_standard_errors, rtol=1e-9)
    assert np.array_equal(outputs, calibration.apply(calibration.errors.distort(axes)))


def test_standard_errors_of_effects_and_of_an_exact_calibration(calibration, recording):
    """Those of an effect are added; without errors of the calibration noise alone is left, the same for all samples."""
    readings = recording.readings_T[:5]
    size = EffectSize(np.zeros(9), np.full(9, 3e-9))
    _, without = calibration.apply(readings, with_errors=True)
    _, errors = replace(calibration, effects=(DRIFT,), effect_sizes=(size,)).apply(readings, with_errors=True)
    assert_allclose(errors**2 - without**2, 9e-18, rtol=1e-6)
    _, noise = replace(calibration, covariance=np.zeros_like(calibration.covariance)).apply(readings, with_errors=True)
    weights = calibration.correction_matrix
    assert_allclose(noise, np.tile(1e-9 * norm(weights, axis=1), (5, 1)), rtol=1e-12)


def test_a_reading_that_is_missing_has_no_standard_error(calibration, recording):
    """Its sample alone."""
    readings = recording.readings_T[:3].copy()
    readings[1, 2, 0] = np.nan
    _, errors = calibration.apply(readings, with_errors=True)
    assert np.isfinite(errors[[0, 2]]).all() and np.isnan(errors[1, :3]).all()


def test_the_figure_shows_residuals_before_and_after_and_the_directions(calibration, recording):
    """A row for each residual with its root mean square, left before and right after, and a map below."""
    figure = calibration.plot(recording)
    *rows, last = figure.subfigs
    titles = [part.get_suptitle() for row in rows for part in row.subfigs]
    assert titles == [
        f"{what}, {state} calibration"
        for what in ("|B| − the scalar reference", "Tensor components")
        for state in ("before", "after")
    ]
    after = rows[0].subfigs[1].axes
    assert [axes.get_title("left") for axes in after] == ["sensor 1", "sensor 2", "sensor 3", "sensor 4", "centre"]
    drawn = after[2].lines[0].get_ydata()
    assert_allclose(drawn, 1e9 * calibration.residuals(recording).sensor_intensity_T[:, 2], rtol=1e-9)
    assert last.axes[0].name == "hammer"


def test_one_sensor_has_no_row_of_the_tensor(recording):
    """Nor a centre."""
    one = Recording(recording.time_s, recording.readings_T[:, :1], recording.scalar_T)
    calibration = calibrate(one, Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))
    assert np.isnan(calibration.residuals(one).tensor_T_per_m).all()
    row, _ = calibration.plot(one).subfigs
    assert [len(part.axes) for part in row.subfigs] == [1, 1]


def test_a_recording_of_another_array_is_refused(calibration, recording):
    """By residuals and plot alike."""
    fewer = replace(recording, readings_T=recording.readings_T[:, :3])
    for ask in (calibration.residuals, calibration.plot):
        with pytest.raises(InputError, match="the calibration is of 4 sensors, the recording of 3"):
            ask(fewer)


def test_without_matplotlib_a_plot_says_what_to_install(calibration, recording, monkeypatch):
    """In one sentence."""
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(InputError, match=r"Calibration.plot needs matplotlib: .*tam_calibration\[report\]"):
        calibration.plot(recording)
