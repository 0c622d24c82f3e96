"""Conversion of units."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.model import units


def test_known_values():
    """Half a turn and the field of Wu 2025 in both units."""
    assert units.to_degrees(np.pi) == 180
    assert units.from_nanotesla(54955.83) == 54955.83e-9
    assert_allclose(units.to_nanotesla(np.array([1e-9, 5e-5])), [1, 50_000])


def test_units_of_one_field_agree():
    """0.5 G, 50 µT and 50 000 nT are the same field."""
    sizes = {"G": 0.5, "mG": 500.0, "uT": 50.0, "mT": 0.05, "nT": 50_000.0, "T": 5e-5}
    assert sizes.keys() == units.TESLA_PER_FIELD_UNIT.keys()
    assert_allclose([size * units.TESLA_PER_FIELD_UNIT[unit] for unit, size in sizes.items()], 5e-5, rtol=1e-14)


@pytest.mark.parametrize(
    ("unit", "factor", "name"),
    [
        ("T", 1e9, "nT"),
        ("T/K", 1e9, "nT/°C"),
        ("T/(K s)", 1e9, "nT/(°C s)"),
        ("T/m²", 1e9, "nT/m²"),
        ("1/T²", 1e-18, "1/nT²"),
        ("rad s²/m", 180 / np.pi, "° s²/m"),
        ("1/K", 1e6, "ppm/°C"),
        ("1/s", 1.0, "1/s"),
        ("Hz", 1.0, "Hz"),
        ("1", 1.0, "1"),
    ],
)
def test_units_for_people(unit, factor, name):
    """Every tesla, kelvin and radian of a compound unit is converted, with its power and on its side of the stroke."""
    found = units.for_people(unit)
    assert_allclose(found[0], factor)
    assert found[1] == name


@pytest.mark.parametrize(("value", "words"), [(219.6, "220"), (9.87, "9.9"), (1.0, "1"), (0.0132, "0.013")])
def test_a_number_is_rounded_without_an_exponent(value, words):
    """Two significant digits, whatever is before the decimal point."""
    assert units.rounded(value) == words
