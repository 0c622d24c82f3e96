"""Whether the messages of sensors and IMU are of the frames that the array file names."""

from collections.abc import Callable

from tam_calibration.messages.cdr import FRAME_ID, read_frame_id
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting


class FrameCheck:
    """The frames that messages must have, and those of which they have others.

    Parameters
    ----------
    mounting : Mounting
        With the names of the frames.
    warn : callable
        Called with the sentence on a stream whose messages are of another frame, each time that it changes.
    """

    def __init__(self, mounting: Mounting, warn: Callable[[str], None]) -> None:
        frames = {sensor_stream(sensor): frame for sensor, frame in enumerate(mounting.frame_ids or (), 1)}
        if mounting.imu_frame_id:
            frames["attitude"] = mounting.imu_frame_id
        self._expected = {stream: f"{frame}\0".encode() for stream, frame in frames.items()}
        self._warn = warn
        self.problems: dict[str, str] = {}

    def check(self, stream: str, message: bytes) -> None:
        """Look at the frame of a serialised message.

        Parameters
        ----------
        stream : str
            That it is of, as in the synchroniser.
        message : bytes
            With a header.
        """
        expected = self._expected.get(stream)
        if expected is None:
            return
        if message.startswith(expected, FRAME_ID):
            self.problems.pop(stream, None)
            return
        frame, stated = read_frame_id(message), expected[:-1].decode()
        problem = f"the messages of {stream} are of the frame {frame or 'without name'}, the array file says {stated}"
        if self.problems.get(stream) != problem:
            self._warn(problem)
        self.problems[stream] = problem
