"""What turns the values of each stream into the array's axes, live and offline."""

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting, Turn


def turns_of(mounting: Mounting) -> dict[str, Turn]:
    """Return what turns the values of a message, by stream; the others' are as they are."""
    turns = {sensor_stream(sensor + 1): turn for sensor, turn in mounting.sensor_turns.items()}
    return turns | ({"attitude": mounting.attitude_turn} if mounting.attitude_turn else {})
