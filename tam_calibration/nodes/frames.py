"""Frames: where `/tf_static` states that they are, and whether messages are of those that the array names."""

import time
from collections.abc import Callable

from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from tam_calibration.messages.cdr import FRAME_ID, read_frame_id
from tam_calibration.messages.samples import expected_frames, other_frame
from tam_calibration.messages.transforms import STATIC_TRANSFORMS, TransformTree
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting
from tam_calibration.model.units import FloatArray
from tam_calibration.nodes.listening import leave, waiting

_LATCHED = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
"""As tf2 publishes and hears static transforms; each of their publishers has a message."""

_PATIENCE_S = 10.0
"""Time for which transforms are waited for: late joiners are discovered within 3 s, and robots start in any order."""

_TURN_S = 0.02
"""Time between looks at what has come: short against the start of a node."""


class StaticTransforms:
    """The static transforms towards the array's frame, which are waited for.

    Parameters
    ----------
    node : Node
        That hears them.
    array_frame : str
        Name of the array's frame.
    """

    def __init__(self, node: Node, array_frame: str) -> None:
        self._node, self._array_frame = node, array_frame
        self._tree = TransformTree()
        self._subscription: Subscription | None = None

    @property
    def are_used(self) -> bool:
        """Whether a frame was looked up."""
        return self._subscription is not None

    def look_up(self, frame: str) -> tuple[FloatArray, FloatArray]:
        """Return the origin (3,) of a frame, metres, and the quaternion (4,) of its axes in the array's frame.

        Raises
        ------
        InputError
            When the messages of tf are not installed, or no transform comes.
        """
        limit = time.monotonic() + _PATIENCE_S
        while (pose := self._tree.pose(frame, self._array_frame)) is None:
            if time.monotonic() > limit:
                raise InputError(
                    f"{STATIC_TRANSFORMS} leads from {self._array_frame} to no {frame}: publish that transform, or "
                    "state positions_m and rotations_deg in the array file"
                )
            self._hear()
        return pose

    def _hear(self) -> None:
        if self._subscription is None:
            self._subscription = self._subscribe()
        for message in waiting(self._subscription):
            self._tree.add(message)
        time.sleep(_TURN_S)

    def _subscribe(self) -> Subscription:
        try:
            from tf2_msgs.msg import TFMessage
        except ImportError:
            raise InputError(
                "it leaves positions to tf, and tf2_msgs is not installed: apt install ros-jazzy-tf2-msgs, or state "
                "positions_m and rotations_deg"
            ) from None
        return self._node.create_subscription(TFMessage, STATIC_TRANSFORMS, leave, _LATCHED, raw=True)

    def close(self) -> None:
        """Hear no more."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)


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
