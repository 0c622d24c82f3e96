"""The closed form is a start that leaves the iteration hardly anything to do."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit.ellipsoid import normalize
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import closed_form
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.simulation import simulate


@pytest.mark.parametrize("noise_factor", [1.0, 5.0])
def test_closed_form_is_all_but_the_estimate(wu_scenario, noise_factor):
    """Principal components and the weighted ellipsoid lie within a thousandth of a standard error of the estimate."""
    noise_T = wu_scenario.array.vector_noise_T * np.array([1, noise_factor, 1, 1])
    array = replace(wu_scenario.array, vector_noise_T=noise_T)
    recording = simulate(replace(wu_scenario, array=array)).recording
    data = normalize(recording)
    matrix, bias = closed_form(data, noise_T / data.radius_T, array.scalar_noise_T / data.radius_T)
    start = SensorErrors.from_matrix(matrix, data.origin_T + data.radius_T * bias)
    calibration = maximum_likelihood(recording, array)
    difference = (start.to_vector() - calibration.errors.to_vector()).ravel()
    told = calibration.standard_errors.ravel()
    assert np.abs(difference[told > 0] / told[told > 0]).max() < 1e-3
