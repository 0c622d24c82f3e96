"""What turns the values of each stream into the array's axes, live and offline."""

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting, Turn


def turns_of(mounting: Mounting) -> dict[str, Turn]:
    """Return what turns the values of a message, by stream; the others' are as they are."""
    turns = {sensor_stream(sensor + 1): turn for sensor, turn in mounting.sensor_turns.items()}
    of_imu = {"attitude": mounting.attitude_turn, "gyroscope": mounting.rate_turn}
    return turns | {stream: turn for stream, turn in of_imu.items() if turn is not None}
