"""Bounds of the intensity of a field: which are bounds, what they let pass, and what is told of the rest."""

from datetime import date

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import (
    EARTH_FIELD,
    STRONGEST_FIELD_T,
    WEAKEST_FIELD_T,
    FieldBounds,
    bounds_at,
    field_at,
    site_field_T,
)


def test_the_earth_has_15_to_100_microtesla():
    """Both ends count; the middle is the geometric one."""
    assert EARTH_FIELD.hold(15e-6) and EARTH_FIELD.hold(100e-6)
    assert not EARTH_FIELD.hold(14.9e-6) and not EARTH_FIELD.hold(100.1e-6)
    assert not EARTH_FIELD.hold(float("nan"))
    assert EARTH_FIELD.middle_T == pytest.approx(np.sqrt(15 * 100) * 1e-6)
    assert str(EARTH_FIELD) == "the Earth's field has 15 to 100 µT"


@pytest.mark.parametrize(
    ("low_T", "high_T"),
    [
        (50e-6, 40e-6),
        (50e-6, 50e-6),
        (0.0, 50e-6),
        (-50e-6, 50e-6),
        (float("nan"), 50e-6),
        (40e-6, float("inf")),
        (48e-9, 52e-9),
        (48e3, 52e3),
    ],
)
def test_what_bounds_no_field_is_refused(low_T, high_T):
    """The wrong order, nothing positive, no number, and the Earth's field in µT or in tesla taken for nT."""
    with pytest.raises(InputError, match=r"a lower and an upper one within 200 to 10000000 nT, not .*: check their"):
        FieldBounds(low_T, high_T)


def test_the_weakest_and_the_strongest_field_are_legal():
    """A shielded room and a coil at the ends."""
    assert FieldBounds(200e-9, 10e-3) == FieldBounds(WEAKEST_FIELD_T, STRONGEST_FIELD_T)


def test_a_scalar_beyond_the_bounds_is_refused():
    """It is told whose bounds they are, and a mistake of units that would explain it."""
    coil = FieldBounds(400e-6, 600e-6)
    coil.require_intensity(500e-6)
    with pytest.raises(
        InputError, match="scalar intensity is 50 µT, but the array's field has 400 to 600 µT: check the"
    ):
        coil.require_intensity(50e-6)
    with pytest.raises(InputError, match="is this µT given as nT"):
        coil.require_intensity(500e-9)


def test_a_bias_may_be_a_hundred_times_the_field():
    """Of the Earth's field at least, for a shield around a sensor makes its bias no smaller."""
    shielded = FieldBounds(1e-6, 3e-6)
    for field in (shielded, EARTH_FIELD):
        field.require_readings(np.array([2e-6, 9.9e-3]))
        with pytest.raises(InputError, match=r"sensor 2 reads 1.01e\+04 µT"):
            field.require_readings(np.array([2e-6, 10.1e-3]))
    FieldBounds(1e-3, 2e-3).require_readings(np.array([190e-3]))
    shielded.require_readings(np.array([10.1e-9]))
    with pytest.raises(InputError, match=r"sensor 1 reads 0\.0099 µT"):
        shielded.require_readings(np.array([9.9e-9]))


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
