import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.fit.published import regress
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.sensor_errors import SensorErrors
from tam_validation.papers import li2018a


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
