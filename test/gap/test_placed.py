"""A gap of the intensity alone is put where it may sit, and so are the causes that may act there."""

import pytest

from tam_calibration.gap.laws.causes import agrees, makes, may_make
from tam_calibration.gap.laws.law import SCALAR, Signature
from tam_calibration.gap.placed import _place_of

EVERY = (1, 2, 3, 4)


def law(name, course, places=((2,),), follows=None, axes=("x",)):
    """Return a law at its places."""
    return Signature(name, course, places[0], axes, 0.95, places, follows, (), 100.0)


@pytest.mark.parametrize(
    ("effect", "found", "expected"),
    [
        ("temperature_drift", law("offset", "channel", follows="temperature"), (True, True, True)),
        ("current_interference", law("offset", "channel", follows="temperature"), (True, False, False)),
        ("platform_field", law("offset", "channel", (EVERY,), "actuator_rudder"), (True, True, True)),
        ("bias_jump", law("offset", "slow"), (True, True, False)),
        ("scale_step", law("offset", "step"), (False, False, False)),
        ("somebody_elses", law("gain", "motion"), (True, True, True)),
    ],
)
def test_an_effect_makes_a_law_by_what_it_does_to_a_reading(effect, found, expected):
    """A course may look like another one, but what follows a recorded channel is made by an effect of that channel."""
    assert (makes(effect, found), may_make(effect, found), agrees(effect, found)) == expected


def test_a_cause_of_the_scalar_moves_to_the_field_where_it_may_act_there():
    """A field that drifts does, an error of the scalar's heading does not."""
    common = law("offset", "slow", (EVERY, SCALAR), axes=())
    assert _place_of("geomagnetic_drift", [common], SCALAR) == EVERY
    assert _place_of("scalar_heading_error", [common], SCALAR) == SCALAR
