"""Effects with numbers in scenario and calibration files."""

import re
from typing import ClassVar

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.effects import library
from tam_calibration.effects.effect import Coefficient, LinearEffect, Term
from tam_calibration.files.schema import check
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.results import effects_schema
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

UNITS = {"offset": "T/K", "scale": "1/K", "angle": "rad", "delay": "s", "square": "T/K²", "inverse": "1/T"}
COMPOUND = {"rate": "T·s/K", "supply": "T/V²", "field": "T", "level": "°C", "product": "V T/(A s)"}
UNITS |= COMPOUND

numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)


class Any(LinearEffect):
    """An effect with a value in each unit at all places."""

    name = "e"
    shape_units: ClassVar = {"delay": "s"}

    def terms(self, covariates, shape):
        """Return the same term everywhere."""
        coefficients = tuple(Coefficient(name, unit) for name, unit in UNITS.items())
        nothing = np.zeros((covariates.sample_count, len(UNITS)))
        rows = np.zeros(len(UNITS), dtype=int), np.arange(len(UNITS))
        places = [(sensor, axis) for sensor in (0, 1, 3, SCALAR, ALL) for axis in (None, 0, 2)]
        return [Term(*place, "t", coefficients, nothing, *rows) for place in places]


@pytest.fixture(autouse=True)
def installed(monkeypatch):
    """Install that effect alone."""
    for module in (library, effects_schema):
        monkeypatch.setattr(module, "installed_effects", lambda: {"e": Any()})


def read(text):
    """Return the effect that a text holds."""
    return check(parse_mapping(text), EffectFile).to_fitted(SensorErrors.none(4), Array(np.eye(4, 3)))


def term_with(values):
    """Return a file with a single term of given values."""
    return f"effect: e\nterms:\n  - {{sensor: 1, term: t, values: {values}}}\n"


@given(
    values=st.dictionaries(st.sampled_from(sorted(UNITS)), numbers, min_size=1),
    sensor=st.sampled_from([0, 3, SCALAR, ALL]),
    axis=st.sampled_from([None, 0, 2]),
    units=st.sampled_from([UNITS, {}]),
)
def test_what_was_written_is_read_again(values, sensor, axis, units):
    """With units or without, every part comes back; numbers without a unit of files to the last bit."""
    part = Contribution(sensor, axis, "t", values, {name: abs(value) for name, value in values.items()})
    fitted = FittedEffect("e", {"delay": 0.25}, (part,), {"delay": 0.01})
    again = read(dump_mapping(effect_to_mapping(fitted, units)))
    assert (again.effect, again.shape, again.shape_errors) == ("e", {"delay": 0.25}, {"delay": 0.01})
    (other,) = again.contributions
    assert (other.sensor, other.axis, other.term) == (sensor, axis, "t")
    for name, value in values.items():
        assert_allclose(other.values[name], value, rtol=3e-16)
        assert_allclose(other.standard_errors[name], abs(value), rtol=3e-16)
    if not units:
        assert other.values == part.values


def test_files_have_nanotesla_and_degrees():
    """Units stand with the numbers: nT for T and deg for rad, others as they are."""
    values = {"offset": 12e-9, "angle": np.pi / 180, "square": 3e-9, "inverse": 5.0, "scale": 2.0}
    mapping = effect_to_mapping(FittedEffect("e", {}, (Contribution(1, 0, "t", values),)), UNITS)
    assert mapping["terms"] == [
        {
            "sensor": 2,
            "axis": "x",
            "term": "t",
            "values": {
                "offset": "12.0 nT/K",
                "angle": "1.0 deg",
                "square": "3.0 nT/K²",
                "inverse": "5.0 1/T",
                "scale": "2.0 1/K",
            },
        }
    ]


@pytest.mark.parametrize(
    ("text", "si"),
    [
        ("{offset: 12 nT/K}", 12e-9),
        ("{offset: 12 nT/°C}", 12e-9),
        ("{field: 0.5 uT}", 5e-7),
        ("{field: 3 T}", 3.0),
        ("{angle: 180 deg}", np.pi),
        ("{scale: 1e-3 1/K}", 1e-3),
        ('{field: "4"}', 4.0),
        ("{field: 7.5}", 7.5),
        *((f"{{rate: 2000 {unit}}}", 2e-6) for unit in ("nT·s/K", "nT s/K", "s*nT / K", "nT·s/°C")),
        ("{rate: 2e-6 T s/K}", 2e-6),
        ("{supply: 80 nT/V²}", 8e-8),
        ("{supply: 80 nT/V^2}", 8e-8),
        ("{product: 3 nT·V/s·A}", 3e-9),
        ("{level: 20 °C}", 20.0),
    ],
)
def test_units_are_converted(text, si):
    """Text with the unit becomes SI, however its product is written."""
    (value,) = read(term_with(text)).contributions[0].values.values()
    assert_allclose(value, si, rtol=1e-15)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ("{offset: 12 nT/F}", "offset: '12 nT/F' must have the unit nT/K"),
        ("{offset: 1.5 nT}", "offset: '1.5 nT' must have the unit nT/K"),
        ("{supply: 80 m}", "supply: '80 m' must have the unit nT/V²"),
        ("{rate: 2 nT/K}", "rate: '2 nT/K' must have the unit nT·s/K"),
        ("{level: 20 K}", "level: '20 K' must have the unit °C"),
        ("{inverse: 12 1/nT}", "'12 1/nT' must have the unit 1/T"),
        ("{offset: much}", "offset: 'much' is no number with a unit such as '12 nT/K'"),
        ("{field: nan nT}", "'nan nT' is no number"),
        ("{field: .inf}", "terms.1.values.field"),
    ],
)
def test_wrong_values_are_named(values, sentence):
    """A value without number or with another unit than the effect's is told with its name."""
    with pytest.raises(InputError, match=re.escape(sentence)):
        read(term_with(values))


def test_an_effect_of_no_installed_package_is_told():
    """Whoever reads a file of another machine learns what to install."""
    with pytest.raises(InputError, match="there is no effect 'supply' here: install its package"):
        read("effect: supply\nterms: []\n")


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("effect: e\n", "'terms' is missing"),
        ("effect: e\nterms:\n  - {sensor: 0, term: t, values: {}}\n", "terms.1.sensor"),
        ("effect: e\nterms:\n  - {sensor: 1, axis: w, term: t, values: {}}\n", "terms.1.axis"),
        ("effect: e\nterms: []\nmore: 1\n", "'more' is not known"),
    ],
)
def test_wrong_files_are_named(text, sentence):
    """Keys and places that cannot be are told."""
    with pytest.raises(InputError, match=sentence):
        read(text)
