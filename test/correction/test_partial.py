"""Outputs of the sensors that are there: errors of the size that is stated, and NaN where nothing tells them."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.correction.parts import EffectSize
from tam_calibration.correction.streaming import PartialCorrection, missing_codes
from tam_calibration.fit import calibrate
from tam_calibration.model.array import OUTPUT_NAMES, Array, tensors_of
from tam_calibration.model.sensor_errors import SensorErrors

DRAWS = 4000
NOISE_T = np.array([1e-9, 2e-9, 0.7e-9, 1.4e-9])
ALL = set(OUTPUT_NAMES)
ALONG_X, ALONG_Y = {"gyy", "gyz", "gzz"}, {"gxx", "gxz", "gzz"}
NOT_DETERMINED = {
    **{(sensor,): set() for sensor in (1, 2, 3, 4)},
    (2, 4): ALONG_X,
    (1, 3): ALONG_Y,
    **{pair: ALL for pair in ((1, 2), (2, 3), (3, 4), (1, 4))},
    **{three: ALL for three in combinations((1, 2, 3, 4), 3)},
}
"""What the cross no longer determines without some sensors: two opposite ones see what varies between them alone."""


def code_of(sensors):
    """Return the code of missing sensors."""
    return sum(1 << sensor - 1 for sensor in sensors)


@pytest.fixture(scope="module")
def calibration(recording, cross):
    """Return a calibration of unequal sensors, whose own uncertainty counts as much as the noise does."""
    made = calibrate(recording, cross)
    return replace(made, array=cross.with_noise(NOISE_T, 1e-10), covariance=600.0 * made.covariance)


@pytest.fixture(scope="module")
def draws(calibration):
    """Return true outputs (N, 9) and raw readings (N, 4, 3) of arrays as the calibration leaves them uncertain."""
    random = np.random.default_rng(14)
    direction = random.normal(size=(DRAWS, 3))
    outputs = np.zeros((DRAWS, 9))
    outputs[:, :3] = calibration.intensity_T * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    outputs[:, 3:8] = 1e-7 * random.normal(size=(DRAWS, 5))
    outputs[:, 8] = -outputs[:, 3] - outputs[:, 6]
    fields = outputs[:, None, :3] + calibration.array.positions_m @ tensors_of(outputs)
    value, vector = np.linalg.eigh(calibration.covariance)
    spread = (vector * np.sqrt(np.maximum(value, 0))) @ random.normal(size=(48, DRAWS))
    found = calibration.errors.to_vector().ravel()
    true = SensorErrors.from_vector(found + spread.T)  # of as many sensors as four times the arrays
    readings = true.distort(fields.reshape(1, -1, 3)).reshape(DRAWS, 4, 3)
    return outputs, readings + NOISE_T[:, None] * random.normal(size=readings.shape)


def corrected(calibration, readings, code):
    """Return the outputs of readings without some sensors."""
    codes = np.full(len(readings), code)
    is_missing = code >> np.arange(4) & 1 == 1
    outputs = np.zeros((len(readings), 9))
    PartialCorrection(calibration).put(outputs, np.where(is_missing[:, None], np.nan, readings), codes)
    return outputs


@pytest.mark.parametrize("missing", NOT_DETERMINED, ids=str)
def test_errors_are_those_that_are_stated(calibration, draws, missing):
    """Of each output that is determined, from its noise and from the calibration; the others are NaN in both."""
    true, readings = draws
    part = PartialCorrection(calibration).without(code_of(missing))
    errors = corrected(calibration, readings, code_of(missing)) - true
    assert set(part.not_determined) == NOT_DETERMINED[missing]
    known = part.is_determined
    assert np.isnan(errors[:, ~known]).all() and np.isnan(part.standard_errors[~known]).all()
    pulls = errors[:, known] / part.standard_errors[known]
    assert_allclose(np.sqrt(np.mean(pulls**2, axis=0)), 1.0, atol=0.05)
    correlations = np.corrcoef(errors[:, known][:, :8].T) if known.any() else 0.0
    stated = part.covariance / np.outer(part.standard_errors, part.standard_errors)
    assert_allclose(correlations, stated[known][:, known][:8, :8] if known.any() else 0.0, atol=0.08)


def perfect(calibration, array):
    """Return the calibration of perfect sensors of an array, exactly known."""
    errors = SensorErrors.none(array.sensor_count)
    return replace(calibration, array=array, errors=errors, covariance=np.zeros((errors.to_vector().size,) * 2))


def test_three_equal_sensors(calibration):
    """Variances of a cross of 0.5 m and 1 nT without sensor 4, worked out from the normal equations by hand."""
    part = PartialCorrection(perfect(calibration, Array.cross(0.5, 1e-9).with_stated_noise())).without(code_of([4]))
    assert_allclose(np.diag(part.covariance), 1e-18 * np.array([3 / 8, 0.5, 0.5, 8, 6, 8, 24, 24, 32]))


@pytest.mark.parametrize(("offset_m", "is_known"), [(1e-7, True), (1e-4, False)])
def test_what_is_determined_follows_from_the_positions(calibration, offset_m, is_known):
    """Where two sensors are not opposite the gradient across moves their mean."""
    array = Array([[0.25, 0, 0], [0, 0.25, 0], [-0.25, offset_m, 0], [0, -0.25, 0]], NOISE_T).with_stated_noise()
    part = PartialCorrection(perfect(calibration, array)).without(code_of([2, 4]))
    assert part.is_determined[:3].all() == is_known


def test_an_array_without_a_gradient_keeps_its_mean(calibration):
    """It takes the field as uniform with all sensors: so it does with those that are left, by their noise."""
    array = Array([[0.25, 0, 0], [0, 0, 0], [-0.25, 0, 0]], np.array([1e-9, 1e-9, 2e-9])).with_stated_noise()
    part = PartialCorrection(perfect(calibration, array)).without(code_of([2]))
    assert part.not_determined == OUTPUT_NAMES[3:]
    assert_allclose(part.matrix[0, ::3], [0.8, 0.0, 0.2])
    assert_allclose(np.diag(part.covariance)[:3], 0.8e-18)


def test_with_all_sensors_nothing_changes(calibration, draws):
    """The outputs keep every bit, whatever stands beside them in a batch."""
    _, readings = draws
    some = readings[:10].copy()
    some[[2, 7], 1] = np.nan
    codes = missing_codes(some)
    outputs = calibration.apply(some)
    PartialCorrection(calibration).put(outputs, some, codes)
    assert codes.tolist() == [0, 0, 2, 0, 0, 0, 0, 2, 0, 0]
    assert np.isfinite(outputs).all()
    kept = codes == 0
    assert_array_equal(outputs[kept], calibration.apply(readings[:10])[kept])


def test_missing_readings_are_filled_by_what_the_others_tell(calibration):
    """Of a uniform field, exactly; what is there stays to the last bit."""
    random = np.random.default_rng(2)
    readings = calibration.errors.distort(50e-6 * random.normal(size=(20, 3)))
    some = readings.copy()
    some[::2, 0] = some[5:10, 2] = np.nan
    filled = PartialCorrection(calibration).filled(some, missing_codes(some))
    assert_allclose(filled, readings, rtol=0, atol=1e-15)
    there = np.isfinite(some)
    assert_array_equal(filled[there], some[there])


def test_a_covariance_is_found_by_its_standard_errors(calibration):
    """Where all is determined; those of all sensors are none of a part."""
    partial = PartialCorrection(calibration)
    for sensor in (1, 2, 3, 4):
        part = partial.without(code_of([sensor]))
        assert_array_equal(partial.covariance_with(part.standard_errors), part.covariance)
    assert partial.covariance_with(partial.without(code_of([1, 3])).standard_errors) is None
    assert partial.covariance_with(calibration.output_standard_errors) is None


def test_what_is_not_known_of_effects_grows_as_the_noise(calibration):
    """Of gyy from three sensors of equal noise three times in variance; with all sensors it is as stated."""
    array = Array.cross(0.5, 1e-9).with_stated_noise()
    size = EffectSize(np.zeros(9), np.full(9, 1e-8))
    made = replace(perfect(calibration, array), effect_sizes=(size,))
    added = np.diag(PartialCorrection(made).without(code_of([4])).covariance)
    assert added[6] == pytest.approx(24e-18 + 3e-16)
    assert made.output_covariance[6, 6] == pytest.approx(8e-18 + 1e-16)


def test_without_any_sensor_nothing_is_determined(calibration):
    """A sample of NaN alone, which no collector makes, has no outputs and ends nothing."""
    readings = np.full((2, 4, 3), np.nan)
    codes = missing_codes(readings)
    partial = PartialCorrection(calibration)
    outputs = np.zeros((2, 9))
    partial.put(outputs, readings, codes)
    assert np.isnan(outputs).all() and np.isnan(partial.without(15).standard_errors).all()
    assert np.isnan(partial.filled(readings, codes)).all()
