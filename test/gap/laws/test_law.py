"""Places of a law, in words and after its cause is known."""

from dataclasses import replace

import pytest

from tam_calibration.gap.laws.law import ATTITUDE, SCALAR, Signature, in_words


@pytest.mark.parametrize(
    ("places", "is_common", "words"),
    [
        (((2,),), False, "sensor 2"),
        (((1, 2, 3, 4),), False, "all sensors"),
        (((1, 3, "scalar"),), False, "sensors 1 and 3 and the scalar"),
        (((1, 2, 3, 4, "scalar"),), False, "all sensors and the scalar"),
        ((SCALAR,), False, "the scalar"),
        ((ATTITUDE,), False, "the attitude"),
        (((1,), (2,)), False, "sensor 1, or sensor 2"),
        (((1, 2, 3, 4), SCALAR), True, "the scalar, or the field at all sensors alike"),
    ],
)
def test_places_are_named(places, is_common, words):
    """Sensors by their numbers, and the scalar next to them where a law acts on both."""
    assert in_words(places, 4, is_common) == words


@pytest.mark.parametrize(
    ("sensors", "axes", "found"),
    [
        ((2,), ("x", "y", "z"), ((2,), ("x", "y", "z"))),
        ((2,), ("y",), ((2,), ("y",))),
        ((2,), ("y", "z"), ((2,), ("y", "z"))),
        ((1, 2), ("y",), ((1, 2, 3, 4), ("x", "y", "z"))),
        ((1, 2, 3, 4, "scalar"), ("x", "y", "z"), ((1, 2, 3, 4, "scalar"), ("x", "y", "z"))),
        ((5,), ("y",), ((1, 2, 3, 4), ("x", "y", "z"))),
    ],
)
def test_a_law_is_where_its_cause_is(sensors, axes, found):
    """A cause in one sensor, in some of its axes, or in more sensors tells where a law is; one in some does not."""
    every = (1, 2, 3, 4)
    law = Signature("rate", "constant", every, ("x", "y", "z"), 1.0, (every,), None, (), 100.0)
    placed = law.at_place(sensors, axes)
    assert (placed.sensors, placed.axes, placed.places) == (*found, (found[0],))


def test_an_axis_of_a_cause_in_the_same_sensor():
    """A law of three axes of a sensor is of the one in which its cause is; the scalar has no axes."""
    law = Signature("offset", "step", (3,), ("x", "y", "z"), 1.0, ((3,),), None, (), 100.0)
    assert law.at_place((3,), ("z",)).axes == ("z",)
    either = replace(law, places=((3,), (1,)))
    assert either.at_place((3,), ("x", "y", "z")).places == either.places
    common = Signature("offset", "slow", SCALAR, (), 1.0, (SCALAR, (1, 2, 3, 4)), None, (), 100.0)
    assert common.at_place(SCALAR, ()) == common
    everywhere = replace(law, sensors=(1, 2, 3, 4), places=((1, 2, 3, 4),))
    at_scalar = everywhere.at_place(SCALAR, ())
    assert (at_scalar.sensors, at_scalar.places, at_scalar.axes) == (SCALAR, (SCALAR,), ())


def test_what_several_sensors_have_shows_at_the_scalar():
    """A law that was found at the scalar is in the sensors of its cause, if they are several."""
    law = Signature("rate", "constant", SCALAR, (), 1.0, (SCALAR,), None, (), 100.0)
    assert law.at_place((1, 2, 3, 4), ("x", "y", "z")).sensors == (1, 2, 3, 4)
    assert law.at_place((2,), ("x", "y", "z")) == law
