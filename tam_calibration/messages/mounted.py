"""What the mounting of an array means for each stream: the frame of its messages, and the turn of its values."""

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting, Turn


def turns_of(mounting: Mounting) -> dict[str, Turn]:
    """Return what turns the values of a message, by stream; the others' are as they are."""
    turns = {sensor_stream(sensor + 1): turn for sensor, turn in mounting.sensor_turns.items()}
    of_imu = {"attitude": mounting.attitude_turn, "gyroscope": mounting.rate_turn}
    return turns | {stream: turn for stream, turn in of_imu.items() if turn is not None}


def expected_frames(mounting: Mounting) -> dict[str, str]:
    """Return the frame that the messages of each stream must have, as far as an array file names it."""
    frames = {sensor_stream(sensor): frame for sensor, frame in enumerate(mounting.frame_ids or (), 1)}
    return frames | ({"attitude": mounting.imu_frame_id} if mounting.imu_frame_id else {})


def other_frame(stream: str, frame: str, stated: str) -> str:
    """Return a warning of messages of another frame than the array file states, with what to do."""
    return (
        f"the messages of {stream} are of the frame {frame or 'without name'}, the array file says {stated}: name the "
        "topics in a map, or correct frame_ids"
    )
