"""Mappings are read by the annotations of dataclasses, each fault told by its key; quantities keep their bounds."""

from copy import deepcopy
from dataclasses import dataclass, field, replace
from datetime import UTC, date, datetime
from typing import Annotated, Any, Literal, get_args

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.files import schema
from tam_calibration.files.schema import Bounds, check, nanotesla_to_write, value_to_write
from tam_calibration.files.text_files import configuration_folder
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees, from_nanotesla
from tam_calibration.results import calibration_from_yaml, calibration_to_yaml
from tam_calibration.results.scenario import scenario_of


@dataclass(frozen=True, kw_only=True)
class _Round:
    kind: Literal["round"]
    radius_m: Annotated[float, Bounds(above=0)]


@dataclass(frozen=True, kw_only=True)
class _Square:
    kind: Literal["square"]
    side_m: Annotated[float, Bounds(least=1, most=2)] = 1.0


@dataclass(frozen=True, kw_only=True)
class _Sample:
    count: Annotated[int, Bounds(least=0)] = 0
    is_held: bool = False
    name: str | None = None
    number: float = 0.0
    noise: float | list[float] = 1.0
    sensor: Annotated[int, Bounds(least=1)] | Literal["all"] = "all"
    place: tuple[float, float] = (0.0, 0.0)
    values: dict[str, float | str] = field(default_factory=dict)
    shape: _Round | _Square | None = None
    shapes: list[_Square] = field(default_factory=list)
    day: date | None = None
    moment: datetime | None = None
    notes: Any = None


READ = [
    ({"number": 3}, 3.0),
    ({"number": 1e-9}, 1e-9),
    ({"count": 2**60 + 1}, 2**60 + 1),
    ({"count": 20.0}, 20),
    ({"noise": [1, 2.0]}, [1.0, 2.0]),
    ({"noise": 2}, 2.0),
    ({"sensor": "all"}, "all"),
    ({"sensor": 2}, 2),
    ({"place": [1, 2]}, (1.0, 2.0)),
    ({"values": {"a": 1, "b": "12 nT"}}, {"a": 1.0, "b": "12 nT"}),
    ({"shape": {"kind": "round", "radius_m": 1}}, _Round(kind="round", radius_m=1.0)),
    ({"shape": None}, None),
    ({"shapes": [{"kind": "square", "side_m": 2}]}, [_Square(kind="square", side_m=2.0)]),
    ({"day": "2016-01-15"}, date(2016, 1, 15)),
    ({"moment": "2016-01-15"}, datetime(2016, 1, 15)),
    ({"moment": "2016-01-15T01:00:30+01:00"}, datetime(2016, 1, 15, 0, 0, 30, tzinfo=UTC)),
    ({"moment": "2016-01-15T00:00:30Z"}, datetime(2016, 1, 15, 0, 0, 30, tzinfo=UTC)),
    ({"notes": {1: [2]}}, {1: [2]}),
    ({"is_held": True}, True),
]


@pytest.mark.parametrize(("content", "value"), READ, ids=[str(content) for content, _ in READ])
def test_values_are_of_the_annotated_type(content, value):
    """Whole numbers become what the field is, and so does text that reads as a date."""
    (name,) = content
    read = getattr(check(content, _Sample), name)
    assert read == value and type(read) is type(value)


FAULTS = [
    ({"number": "wide"}, "number: input should be a valid number"),
    ({"number": True}, "number: input should be a valid number"),
    ({"number": 10**400}, "number: input should be a valid number"),
    ({"number": "1e-9"}, "number: input should be a valid number"),
    ({"count": "20"}, "count: input should be a valid integer"),
    ({"count": 2.5}, "count: input should be a valid integer"),
    ({"count": float("nan")}, "count: input should be a valid integer"),
    ({"count": 1e308}, "count: input should be a valid integer"),
    ({"count": 10**300}, "count: input should be a valid integer"),
    ({"count": float("inf")}, "count: input should be a valid integer"),
    ({"count": -1}, "count: input should be greater than or equal to 0"),
    ({"sensor": 0}, "sensor: input should be greater than or equal to 1"),
    ({"is_held": 1}, "is_held: input should be a valid boolean"),
    ({"name": 3}, "name: input should be a valid string"),
    ({"noise": "much"}, "noise: input should be a valid number"),
    ({"noise": [1, "much"]}, "noise.2: input should be a valid number"),
    ({"place": 3}, "place: input should be a valid list"),
    ({"place": [1]}, "the key 'place.2' is missing"),
    ({"place": [1, 2, 3]}, "place: tuple should have at most 2 items, not 3"),
    ({"values": {1: 2}}, "values: input should be a valid string"),
    ({"values": 3}, "values: input should be a mapping of keys to values"),
    ({"shape": 3}, "shape: input should be a mapping of keys to values"),
    ({"shape": {"radius_m": 1}}, "the key 'shape.kind' is missing"),
    ({"shape": {"kind": "flat"}}, "shape: the kind 'flat' is not one of round, square"),
    ({"shape": {"kind": "round"}}, "the key 'shape.radius_m' is missing"),
    ({"shape": {"kind": "round", "radius_m": 0}}, "shape.radius_m: input should be greater than 0"),
    ({"shape": {"kind": "round", "radius_m": float("inf")}}, "shape.radius_m: input should be a finite number"),
    ({"shapes": [{"kind": "square", "side_m": 3}]}, "shapes.1.side_m: input should be less than or equal to 2"),
    ({"shapes": [{"kind": "round"}]}, "shapes.1.kind: input should be 'square'"),
    ({"shapes": [{"kind": "square", "size": 3}]}, "the key 'shapes.1.size' is not known"),
    ({"day": "2016-01-15T12:00"}, "day: input should be a valid date"),
    ({"day": 20160115}, "day: input should be a valid date"),
    ({"moment": "noon"}, "moment: input should be a valid datetime"),
    ({"moment": "0001-01-01T00:00+14:00"}, "moment: input should be a valid datetime"),
    ({"moment": 1452816000}, "moment: input should be a valid datetime"),
    ({"number": "a", "count": "b", "name": 3}, "count: input should be a valid integer"),
]


@pytest.mark.parametrize(("content", "sentence"), FAULTS, ids=[str(content) for content, _ in FAULTS])
def test_a_fault_is_told_by_its_key(content, sentence):
    """Lists count from one; the first fault in the order of the schema is told."""
    with pytest.raises(InputError) as problem:
        check(content, _Sample)
    assert str(problem.value) == sentence


def test_keys_that_may_be_there_are_listed():
    """Where a key of the file itself is not known."""
    with pytest.raises(InputError, match=r"^the key 'size' is not known; known are kind, side_m$"):
        check({"kind": "square", "size": 1}, _Square)


BOUNDS = {
    "ScaleFactor": (1e-4, 1e4),
    "Nanotesla": (-1e9, 1e9),
    "NanoteslaSize": (0, 1e12),
    "Degrees": (-360, 360),
    "Shear": (-85, 85),
    "Metres": (-1e6, 1e6),
    "AmpereSquareMetres": (-1e12, 1e12),
    "Seconds": (-9.2e9, 9.2e9),
    "Period": (1e-6, 1e9),
    "Hertz": (1e-9, 1e6),
    "Celsius": (-273.15, 1e4),
    "Ampere": (-1e6, 1e6),
}


@pytest.mark.parametrize(("name", "bounds"), BOUNDS.items())
def test_each_quantity_has_bounds(name, bounds):
    """They are told with unit and value."""
    [_, kept] = get_args(getattr(schema, name))
    assert (kept.least, kept.most) == bounds
    assert not any(map(kept.broken_by, bounds))
    assert kept.broken_by(1e13).endswith(f"{bounds[1]} {kept.unit}, not 1e+13: check the unit")
    assert kept.broken_by(float("inf")) == "a finite number"


@pytest.fixture(scope="module")
def calibration_content(recording, cross):
    """Return keys and values of the calibration file of two sensors."""
    array = Array(cross.positions_m[:2], cross.vector_noise_T[:2], cross.scalar_noise_T)
    pair = replace(recording, readings_T=recording.readings_T[:, :2])
    return yaml.safe_load(calibration_to_yaml(calibrate(pair, array)))


@pytest.mark.parametrize(
    ("keys", "value", "sentence"),
    [
        (
            ("sensors", 0, "scale_factor", 1),
            1e-12,
            "sensors.1.scale_factor.2: input should be greater than or equal to",
        ),
        (
            ("sensors", 1, "bias_nT", 0),
            1e300,
            "sensors.2.bias_nT.1: input should be less than or equal to .* not 1e.300",
        ),
        (("sensors", 0, "non_orthogonality_deg", 2), 90.0, "less than or equal to 85 deg, not 90"),
        (("sensors", 1, "misalignment_deg", 0), -1e300, "greater than or equal to -360 deg"),
        (("sensors", 1, "bias_standard_error_nT", 0), -1.0, "bias_standard_error_nT.1: .* greater than or equal to 0"),
        (("field", "intensity_nT"), 1e300, "field.intensity_nT"),
        (("field", "coverage_of_sphere"), 1.5, "coverage_of_sphere: input should be less than or equal to 1"),
        (("residuals", "before", "center_intensity_nT"), 1e300, "residuals.before.center_intensity_nT"),
        (("residuals", "before", "sensor_intensity_nT"), [1.0], "residuals must be those of its 2 sensors"),
        (("recording", "time_span_s", 0), 1e300, "recording.time_span_s.1"),
        (("covariance_SI", 0, 0), 1e300, "covariance_SI.1.1: input should be less than or equal to 1000000000000.0"),
        (("array", "positions_m", 0, 0), 1e300, "the position of a sensor"),
    ],
)
def test_a_calibration_of_nonsense_is_refused(calibration_content, keys, value, sentence):
    """The key is named, and no arithmetic overflows before."""
    content = deepcopy(calibration_content)
    *path, last = keys
    part = content
    for key in path:
        part = part[key]
    part[last] = value
    with pytest.raises(InputError, match=sentence):
        calibration_from_yaml(dump_mapping(content), "c.yaml")


@pytest.mark.parametrize(
    ("keys", "value", "sentence"),
    [
        (("site", "intensity_nT"), 1e-300, "site.intensity_nT: input should be greater than or equal to 0.001 nT"),
        (("site", "declination_deg"), 1e300, "site.declination_deg"),
        (("rate_hz",), 1e-300, "rate_hz: input should be greater than or equal to 1e-09 Hz"),
        (("rate_hz",), 1e300, "rate_hz: input should be less than or equal to 1000000.0 Hz"),
        (("array", "vector_noise_nT"), 1e300, "the noise of a sensor"),
        (("array", "vector_noise_nT"), 1e-300, "the noise of a sensor"),
        (("motion", "turn_rate_deg_per_s"), 1e300, "motion.turn_rate_deg_per_s"),
        (("temperature", "noise_C"), 1e300, "temperature.noise_C: input should be less than or equal to"),
        (("temperature", "start_C"), -300, "temperature.start_C: input should be greater than or equal to -273.15"),
        (("effects", 0, "shape", "time_constant_s"), 1e31, "time_constant_s: 1e.31 is more than 1e.30 in SI"),
        (("effects", 0, "terms", 0, "values", "offset"), "1e40 nT/K", "offset: '1e40 nT/K' is more than 1e.30 in SI"),
    ],
)
def test_a_scenario_of_nonsense_is_refused(keys, value, sentence):
    """The key is named, and no arithmetic overflows before."""
    folder = configuration_folder() / "scenarios"
    content = yaml.safe_load((folder / "warming_up.yaml").read_text())
    *path, last = keys
    part = content
    for key in path:
        part = part[key]
    part[last] = value
    with pytest.raises(InputError, match=sentence):
        scenario_of(content, folder)


@given(st.lists(st.decimals(-1_000_000, 1_000_000, places=4), min_size=1))
def test_decimals_in_nanotesla_come_back(decimals):
    """Decimals in nT that were read are written as the same decimals."""
    values = np.array([float(value) for value in decimals])
    assert from_nanotesla(nanotesla_to_write(from_nanotesla(values))).tolist() == from_nanotesla(values).tolist()


@given(st.lists(st.floats(-1, 1), min_size=1))
def test_any_value_comes_back_to_the_last_bits(values):
    """Where no decimal reads as the very number, the one written differs in the last bit."""
    assert_allclose(from_nanotesla(nanotesla_to_write(np.array(values))), values, rtol=3e-16, atol=1e-300)
    assert_allclose(
        from_degrees(np.array(value_to_write("angle_deg", np.array(values)))), values, rtol=3e-16, atol=1e-300
    )
