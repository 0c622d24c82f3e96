"""Places of a law in words."""

import pytest

from tam_calibration.gap.laws.law import ATTITUDE, SCALAR, in_words


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
