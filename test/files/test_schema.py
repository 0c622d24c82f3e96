"""Mappings are read by the annotations of dataclasses; each fault is told by its key."""

from dataclasses import dataclass, field
from datetime import UTC, date, datetime
from typing import Annotated, Any, Literal

import pytest

from tam_calibration.files.schema import Bounds, check
from tam_calibration.model.exceptions import InputError


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
    ({"number": "a", "count": "b", "name": 3}, "count: input should be a valid integer (and 2 more faults)"),
]


@pytest.mark.parametrize(("content", "sentence"), FAULTS, ids=[str(content) for content, _ in FAULTS])
def test_a_fault_is_told_by_its_key(content, sentence):
    """Lists count from one; the first fault in the order of the schema is told, and how many others there are."""
    with pytest.raises(InputError) as problem:
        check(content, _Sample)
    assert str(problem.value) == sentence


def test_keys_that_may_be_there_are_listed():
    """Where a key of the file itself is not known."""
    with pytest.raises(InputError, match=r"^the key 'size' is not known; known are kind, side_m$"):
        check({"kind": "square", "size": 1}, _Square)
