"""Places of sensors in words."""

import pytest

from tam_calibration.model.exceptions import sensors_in_words


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([2],), "sensor 2"),
        (([1, 2, 4], 4), "sensors 1, 2 and 4"),
        (([1, 2], 2), "all sensors"),
        (([1], 1), "sensor 1"),
        (([3], 4, ["x"]), "sensor 3, axis x"),
        (([1, 2, "scalar"], 4, ["x", "z"]), "sensors 1 and 2, axes x and z and the scalar"),
        ((["scalar"], 4, ["x"]), "the scalar"),
        (([], 4), "nowhere"),
    ],
)
def test_a_place_in_words(arguments, words):
    """All sensors are not named one by one, nor all axes."""
    assert sensors_in_words(*arguments) == words
