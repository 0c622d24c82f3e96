"""The geomagnetic model is IGRF-14 as IAGA's own Python code evaluates it."""

from datetime import date, datetime

import numpy as np
import ppigrf
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.geomagnetic_field import site_field_T

FIRST, LAST = date(1900, 1, 1).toordinal(), date(2029, 12, 31).toordinal()


def test_agrees_with_the_code_of_iaga():
    """Anywhere, at any height and day, within 1 pT: that code takes the sine of the ellipsoid's angle for the angle."""
    rng = np.random.default_rng(14)
    for _ in range(12):
        latitude, longitude = rng.uniform(-90, 90), rng.uniform(-180, 360)
        height_m, day = rng.uniform(-10e3, 600e3), date.fromordinal(int(rng.integers(FIRST, LAST + 1)))
        theirs = ppigrf.igrf(longitude, latitude, height_m / 1e3, datetime(day.year, day.month, day.day))
        assert_allclose(site_field_T(latitude, longitude, height_m, day), np.ravel(theirs) * 1e-9, rtol=0, atol=1e-12)


@pytest.mark.parametrize("latitude", [90, -90])
def test_the_poles_are_places_like_others(latitude):
    """The field there is that of a place a centimetre away, and turns with the longitude that names the axes."""
    day = date(2025, 6, 1)
    at_pole = site_field_T(latitude, 10.0, 0.0, day)
    assert_allclose(at_pole, site_field_T(latitude * (1 - 1e-9), 10.0, 0.0, day), atol=1e-14)
    turned = site_field_T(latitude, 100.0, 0.0, day)
    assert_allclose(turned, [np.sign(latitude) * at_pole[1], -np.sign(latitude) * at_pole[0], at_pole[2]], rtol=1e-9)


def test_the_first_and_the_last_day_are_in_the_model():
    """Its coefficients are those of 1900 to 2030."""
    for day in (FIRST, LAST):
        assert 20e-6 < np.linalg.norm(site_field_T(0.0, 0.0, 0.0, date.fromordinal(day))) < 70e-6
