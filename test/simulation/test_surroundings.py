"""Site field, drift and dipole."""

import magpylib
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.testing import assert_allclose

from tam_calibration.model.exceptions import InputError
from tam_calibration.simulation.conditions import ObservedDrift, RampDrift, SinusoidDrift, field_from_elements
from tam_calibration.sources.dipole import Dipole

SITE = np.array([-4e-6, 25e-6, -48e-6])
VECTORS = arrays(float, 3, elements=st.floats(-5, 5))


@given(intensity=st.floats(20e-6, 70e-6), inclination=st.floats(-1.5, 1.5), declination=st.floats(-3.1, 3.1))
def test_elements_come_back(intensity, inclination, declination):
    """Intensity, inclination and declination of the field are those asked for."""
    east, north, up = field_from_elements(intensity, inclination, declination)
    assert_allclose(np.linalg.norm([east, north, up]), intensity, rtol=1e-12)
    assert_allclose(np.arctan2(-up, np.hypot(east, north)), inclination, atol=1e-12)
    assert_allclose(np.arctan2(east, north), declination, atol=1e-12)


@pytest.mark.parametrize("drift", [SinusoidDrift(8.26e-9, 40.0), RampDrift(8.26e-9)])
@pytest.mark.parametrize("count", [2, 72, 1001])
def test_drift_has_the_stated_standard_deviation(drift, count):
    """The intensity of the drifting field has the standard deviation asked for and the site's as mean."""
    field = SITE + drift.variation_T(np.arange(count) * 0.7, SITE)
    intensity = np.linalg.norm(field, axis=1)
    assert_allclose(intensity.std(), 8.26e-9, rtol=1e-6)
    assert_allclose(intensity.mean(), np.linalg.norm(SITE), rtol=1e-12)


@pytest.mark.parametrize("drift", [SinusoidDrift(8.26e-9, 40.0), RampDrift(8.26e-9)])
def test_one_sample_cannot_drift(drift):
    """A single sample has no standard deviation."""
    with pytest.raises(InputError, match="one sample cannot drift"):
        drift.variation_T(np.zeros(1), SITE)


def test_observed_drift_is_turned_into_the_meridian_of_the_site():
    """A rise of H raises the horizontal intensity, one of E turns the field to the east, one of Z raises that down."""
    time = np.arange(0, 100, 10.0)
    for axis, direction in enumerate([(-4 / np.hypot(4, 25), 25 / np.hypot(4, 25), 0), (25, 4, 0), (0, 0, -1)]):
        record = np.zeros((10, 3))
        record[:, axis] = np.linspace(-45e-9, 45e-9, 10)
        variation = ObservedDrift(time, record).variation_T(np.array([5.0, 85.0]), SITE)
        expected = 80e-9 * np.array(direction) / np.linalg.norm(direction)
        assert_allclose(variation[1] - variation[0], expected, atol=1e-15)


def test_observed_drift_leaves_the_mean_to_the_site():
    """The record's own level does not matter, only its change."""
    time = np.arange(5.0)
    record = np.full((5, 3), 3e-5) + np.outer(np.arange(5), [1e-9, 2e-9, 3e-9])
    assert_allclose(ObservedDrift(time, record).variation_T(time, SITE).mean(axis=0), 0, atol=1e-18)


@pytest.mark.parametrize(("start", "gap"), [(0.0, True), (3.0, False), (-1.0, False)])
def test_observed_drift_refuses_a_gap(start, gap):
    """A missing value in the span, or a record that is too short, is said and not invented."""
    record = np.zeros((5, 3))
    if gap:
        record[2, 1] = np.nan
    with pytest.raises(InputError, match="gap within the 4 s of the simulation"):
        ObservedDrift(np.arange(5.0), record).variation_T(start + np.arange(5.0), SITE)


@given(VECTORS, VECTORS, VECTORS)
def test_dipole_agrees_with_magpylib(position, moment, offset):
    """The field is that of an independent implementation."""
    if np.linalg.norm(offset) < 0.1:
        offset = offset + np.array([0.5, 0, 0])
    points = position + np.array([offset, -offset])
    expected = magpylib.misc.Dipole(position=position, moment=moment).getB(points)
    assert_allclose(Dipole(position, moment).field_T(points), expected, rtol=1e-7, atol=1e-20)


@given(VECTORS, VECTORS)
def test_gradient_is_symmetric_trace_free_and_the_derivative_of_the_field(moment, point):
    """Outside its source the tensor obeys Maxwell, and it is the slope of the field."""
    if np.linalg.norm(point) < 0.5:
        point = point + np.array([1.0, 0, 0])
    dipole = Dipole(np.zeros(3), moment)
    gradient = dipole.gradient_T_per_m(point)
    scale = 1e-7 * (np.linalg.norm(moment) + 1e-12) / np.linalg.norm(point) ** 4
    step = 1e-4 * np.linalg.norm(point)
    slope = (dipole.field_T(point + step * np.eye(3)) - dipole.field_T(point - step * np.eye(3))).T / (2 * step)
    assert_allclose(gradient, gradient.T, atol=1e-12 * scale)
    assert_allclose(np.trace(gradient), 0, atol=1e-12 * scale * 15)
    assert_allclose(gradient, slope, atol=1e-5 * scale)
