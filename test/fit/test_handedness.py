"""Mirror images among sensors are told by their numbers."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit.calibrate import METHODS
from tam_calibration.fit.moments import mirror_images, require_one_hand
from tam_calibration.model.exceptions import InputError


@pytest.mark.parametrize(
    ("hands", "words"),
    [
        ([1, -1, 1, 1], "sensor 2 is a mirror image of sensors 1, 3 and 4"),
        ([1, -1, -1, -1], "sensor 1 is a mirror image of sensors 2, 3 and 4"),
        ([-1, -1, 1, 1], "sensors 1 and 2 are mirror images of sensors 3 and 4"),
        ([0, -1, 1], "sensor 2 is a mirror image of sensor 3"),
        ([-1], "sensor 1 is a mirror image of the reference"),
        ([-1, -1, -1], "sensors 1, 2 and 3 are mirror images of the reference"),
    ],
)
def test_the_fewer_are_named_first(hands, words):
    """Whichever of them is the reference; one that cannot be told is in neither group."""
    assert mirror_images(np.array(hands)) == words


def test_sensors_of_one_hand_pass():
    """With any leading axes; one set that shows the mirror image is enough."""
    matrix = np.tile(np.eye(3), (2, 4, 1, 1))
    require_one_hand(matrix)
    matrix[1, 2, 0] *= -1
    with pytest.raises(
        InputError, match=r"^sensor 3 is a mirror image of sensors 1, 2 and 4: check the order and signs"
    ):
        require_one_hand(matrix)


@pytest.mark.parametrize(("sensor", "others"), [(0, "2, 3 and 4"), (2, "1, 2 and 4")])
@pytest.mark.parametrize("method", METHODS)
def test_every_method_names_the_sensor_that_is_mirrored(wu_scenario, noise_free, method, sensor, others):
    """Sensor 1 too, though the others are aligned to its frame."""
    readings = noise_free.recording.readings_T.copy()
    readings[:, sensor, 0] *= -1
    with pytest.raises(InputError, match=rf"^sensor {sensor + 1} is a mirror image of sensors {others}"):
        METHODS[method](replace(noise_free.recording, readings_T=readings), wu_scenario.array)
