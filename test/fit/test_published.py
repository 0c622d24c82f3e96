"""What single published methods have of their own: orders, alignments, and regressions that are refused."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from tam_calibration.fit.information import bound
from tam_calibration.fit.moments import rotation_by_regression
from tam_calibration.fit.published import lossless, regress, simplified_linear, two_step_linear
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_validation.papers import li2018a


@pytest.mark.parametrize(("size", "bias_T", "scale"), [(1.0, 3.5e-9, 1.3e-3), (0.1, 3.5e-11, 1.3e-5)])
def test_what_the_simplified_linear_method_leaves_is_of_second_order(noise_free, wu_scenario, size, bias_T, scale):
    """Of errors a tenth as large it leaves a hundredth."""
    none = SensorErrors.none(4).to_vector()
    errors = SensorErrors.from_vector(none + size * (noise_free.errors.to_vector() - none))
    recording = replace(noise_free.recording, readings_T=errors.distort(noise_free.center_field_T))
    found = simplified_linear(recording, wu_scenario.array).errors
    assert np.abs(found.bias_T - errors.bias_T).max() == pytest.approx(bias_T, rel=0.3)
    assert np.abs(found.scale_factor - errors.scale_factor).max() == pytest.approx(scale, rel=0.3)


def test_with_a_constant_intensity_two_steps_have_the_ellipsoid_of_wu(wu_run, wu_scenario):
    """Bias, scale factors and non-orthogonality are those of the lossless calibration; the alignment is another."""
    constant = replace(wu_run.recording, scalar_T=np.full(wu_run.recording.sample_count, 54955.83e-9))
    found = two_step_linear(constant, wu_scenario.array).errors.to_vector()
    expected = lossless(constant, wu_scenario.array).errors.to_vector()
    assert_allclose(found[:, :9], expected[:, :9], rtol=0, atol=1e-13)
    assert 1e-8 < np.abs(found - expected)[1:, 9:].max() < 1e-5


def test_the_alignment_of_two_steps_reaches_the_bound(wu_runs, wu_scenario):
    """The errors of an ellipsoid's triangular factor do not reach what is regressed below its diagonal."""
    least = bound(wu_runs[0].center_field_T, wu_scenario.errors, wu_scenario.array, has_scalar=True)
    least = np.diag(least).reshape(-1, 12)[1:, 9:]

    def efficiency(method):
        found = [method(run.recording, wu_scenario.array).errors.misalignment for run in wu_runs]
        return np.mean(np.mean(np.square(found - wu_scenario.errors.misalignment), axis=0)[1:] / least)

    assert efficiency(two_step_linear) == pytest.approx(1.0, abs=0.24)
    assert efficiency(lossless) > 1.4


@pytest.fixture(scope="module")
def case():
    """Return the paper's simulation."""
    return li2018a.set_up()


def test_the_levenberg_marquardt_step_is_a_linear_regression(case):
    """The paper's iteration on twelve parameters ends at the affine regression, to rounding."""
    some = slice(None, None, 100)
    readings, field = case.recording.readings_T[some, 0] / case.intensity_T, case.field_T[some] / case.intensity_T

    def residuals(parameters):
        return (SensorErrors.from_vector(parameters).restore(readings[:, None])[:, 0] - field).ravel()

    iterated = least_squares(residuals, SensorErrors.none(1).to_vector()[0], method="lm", xtol=1e-15, ftol=1e-15)
    rows = np.column_stack([readings, np.ones(len(readings))])
    unmix, bias = regress(rows.T @ rows, rows.T @ field)
    regressed = SensorErrors.from_matrix(np.linalg.inv(unmix)[None], bias[None])
    assert_allclose(regressed.to_vector()[0], iterated.x, rtol=0, atol=1e-9)
    assert np.sum(residuals(regressed.to_vector()[0]) ** 2) <= (1 + 1e-9) * 2 * iterated.cost


def test_readings_in_a_plane_are_refused():
    """A singular regression is a sentence, not a traceback."""
    with pytest.raises(InputError, match="do not lie on an ellipsoid"):
        regress(np.diag([1.0, 1.0, 0.0, 1.0]), np.ones((4, 3)))


def test_regression_says_what_it_cannot_find():
    """A sensor that is turned by more than 80 degrees is named, not given a wrong angle."""
    most, more = (Rotation.from_euler("z", angle, degrees=True).as_matrix()[None] for angle in (79.9, 80.1))
    assert_allclose(rotation_by_regression(np.swapaxes(most, 1, 2)), most, atol=1e-14)
    with pytest.raises(InputError, match="sensor 1 is turned by more than 80°"):
        rotation_by_regression(more)
