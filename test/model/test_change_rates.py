"""Errors of sensors wander with the root of time, and follow the temperature."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.exceptions import InputError


def test_changes_grow_with_the_root_of_time_and_with_the_temperature():
    """Four days are twice one, ten kelvin ten times one, and both add up as variances do; the side does not matter."""
    rates = ChangeRates()
    one, four = rates.variances(DAY_S, 0.0), rates.variances(4 * DAY_S, 0.0)
    assert_allclose(np.sqrt(four), 2 * np.sqrt(one))
    assert_allclose(np.sqrt(rates.variances(0.0, -10.0)), 10 * np.sqrt(rates.variances(0.0, 1.0)))
    assert_allclose(rates.variances(DAY_S, 3.0), one + rates.variances(0.0, 3.0))
    assert_allclose(rates.variances(-DAY_S, 0.0), one)


def test_defaults_are_those_of_survey_fluxgates():
    """Half a nanotesla and 5 ppm a day, 0.1 nT and 20 ppm a kelvin, angles of thousandths of a degree."""
    day, kelvin = np.sqrt(ChangeRates().variances(DAY_S, 0.0)), np.sqrt(ChangeRates().variances(0.0, 1.0))
    assert_allclose(day[[0, 6]], [5e-6, 0.5e-9])
    assert_allclose(kelvin[[0, 6]], [20e-6, 0.1e-9])
    assert_allclose(np.degrees(day[[3, 9]]), [0.0005, 0.001])
    assert_allclose(np.degrees(kelvin[[3, 9]]), [0.0002, 0.0002])


@pytest.mark.parametrize("value", [-1e-9, np.nan, 0.5])
def test_rates_that_no_sensor_has_are_refused(value):
    """Negative, unknown, or a bias of half a tesla a day: another unit."""
    with pytest.raises(InputError, match="rate of change bias_per_day"):
        ChangeRates(bias_per_day=value)
