"""Whether the messages of sensors and IMU are of the frames that the array file names."""

from collections.abc import Callable

from tam_calibration.messages.cdr import FRAME_ID, read_frame_id
from tam_calibration.messages.mounted import expected_frames, other_frame
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
        self._expected = {stream: f"{frame}\0".encode() for stream, frame in expected_frames(mounting).items()}
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
        problem = other_frame(stream, read_frame_id(message), expected[:-1].decode())
        if self.problems.get(stream) != problem:
            self._warn(problem)
        self.problems[stream] = problem
