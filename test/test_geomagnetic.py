"""The geomagnetic reference field of a place."""

from datetime import date

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.exceptions import InputError
from tam_calibration.geomagnetic import bounds_at, field_at, site_field_T

FOOT_M = 0.3048

# North, east, down in nT as printed in the sample output of NOAA's Geomag 7.0 with IGRF-12.
# It held 2015 as provisional, IGRF-14 as definitive: they may differ by a few nT.
PUBLISHED = [
    (0.0, 0.0, 0.0, (27548.3, -2623.4, -15797.1)),
    (43 + 22 / 60 + 1 / 3600, -(54 + 36 / 60 + 9 / 3600), 30000 * FOOT_M, (20541.2, -6516.4, 44354.7)),
]


@pytest.mark.parametrize(("latitude", "longitude", "height", "north_east_down"), PUBLISHED)
def test_agrees_with_published_values(latitude, longitude, height, north_east_down):
    """The field of 2015 is the published one within 5 nT."""
    north, east, down = north_east_down
    field = site_field_T(latitude, longitude, height, date(2015, 1, 1))
    assert_allclose(field * 1e9, [east, north, -down], atol=5)


def test_direction_and_size_at_boulder():
    """At Boulder in January 2016 intensity and inclination are the observatory's, but for crust and baseline."""
    east, north, up = site_field_T(40.137, 254.764, 1682.0, date(2016, 1, 15))
    assert_allclose(np.linalg.norm([east, north, up]), 52258e-9, rtol=3e-3)
    assert_allclose(np.arctan2(-up, np.hypot(east, north)), np.arctan2(47370, 20736), atol=np.radians(0.3))


def test_longitude_is_periodic():
    """A longitude east of 180° is the same place as the one west of Greenwich."""
    day = date(2020, 6, 1)
    assert_allclose(site_field_T(40.0, 254.5, 0.0, day), site_field_T(40.0, -105.5, 0.0, day), rtol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ((91.0, 0.0, 0.0, date(2020, 1, 1)), "latitude must lie between -90 and 90"),
        ((0.0, 361.0, 0.0, date(2020, 1, 1)), "longitude must lie between -180 and 360"),
        ((0.0, 0.0, 1e9, date(2020, 1, 1)), "height must lie between"),
        ((0.0, 0.0, 0.0, date(1850, 1, 1)), "from 1900 to 2029, not in 1850"),
        ((0.0, 0.0, 0.0, date(2030, 1, 1)), "from 1900 to 2029, not in 2030"),
        ((float("nan"), 0.0, 0.0, date(2020, 1, 1)), "latitude must lie between"),
    ],
)
def test_refuses_what_the_model_does_not_hold(arguments, sentence):
    """Places and days outside the model are named."""
    with pytest.raises(InputError, match=sentence):
        site_field_T(*arguments)


def test_bounds_lie_a_factor_of_one_and_a_half_about_the_model():
    """Steel of a building makes more than crust does; the middle is the model's."""
    bounds = bounds_at("47.37,8.54,2025-06-30")
    intensity_T = np.linalg.norm(field_at("47.37,8.54,2025-06-30"))
    assert_allclose([bounds.low_T, bounds.high_T], [intensity_T / 1.5, intensity_T * 1.5])
    assert_allclose(bounds.middle_T, intensity_T)
    assert str(bounds) == "the place's field has 32.22 to 72.5 µT"
