"""Effects with numbers in scenario and calibration files."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.files.schema import check
from tam_calibration.files.yaml_document import dump_mapping, parse_mapping
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.results.effects_schema import EffectFile, effect_to_mapping

UNITS = {"offset": "T/K", "scale": "1/K", "angle": "rad", "delay": "s", "square": "T/K²", "inverse": "1/T"}

numbers = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e6, max_value=1e6)


def read(text):
    """Return the effect that a text holds."""
    return check(parse_mapping(text), EffectFile).to_fitted()


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
        ("12 nT/K", 12e-9),
        ("0.5 uT", 5e-7),
        ("3 T", 3.0),
        ("180 deg", np.pi),
        ("1e-3 1/K", 1e-3),
        ("4", 4.0),
        ("7.5", 7.5),
    ],
)
def test_units_are_converted(text, si):
    """Text with a unit becomes SI."""
    assert_allclose(read(term_with(f"{{a: {text}}}")).contributions[0].values["a"], si, rtol=1e-15)


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ("{a: 12 nT/F}", "a: the unit 'nT/F' is not known: write T, nT"),
        ("{a: 12 1/nT}", "the unit '1/nT' is not known"),
        ("{a: much}", "a: 'much' is no number with a unit such as '12 nT/K'"),
        ("{a: nan nT}", "'nan nT' is no number"),
        ("{a: .inf}", "terms.1.values.a"),
    ],
)
def test_wrong_values_are_named(values, sentence):
    """A value without number or with an unknown unit is told with its name."""
    with pytest.raises(InputError, match=sentence):
        read(term_with(values))


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
