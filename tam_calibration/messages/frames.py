"""The frames that an array file names, and messages that are of others."""

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting


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
