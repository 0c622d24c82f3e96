"""The static transforms of tf: read from serialised ``tf2_msgs/TFMessage``, and put together from frame to frame."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tam_calibration.messages.cdr import BODY, unpack_from
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

STATIC_TRANSFORMS = "/tf_static"
"""Where tf2 publishes the transforms that do not change."""


class Transform(NamedTuple):
    """Where a frame is in its parent: its origin (3,), metres, and the quaternion (4,) x, y, z, w of its axes."""

    parent: str
    child: str
    position_m: FloatArray
    rotation: FloatArray


def read_transforms(message: bytes) -> list[Transform]:
    """Return the transforms of a serialised ``tf2_msgs/TFMessage``.

    Raises
    ------
    InputError
        When the message is truncated or not plain CDR.
    """
    transforms, (count,), place = [], unpack_from(message, "I", BODY), BODY + 4
    for _ in range(count):
        place = _aligned(place, 4) + 8  # the stamp, which a static transform does not need
        parent, place = _string(message, place)
        child, place = _string(message, place)
        place = _aligned(place, 8)
        numbers = np.array(unpack_from(message, "7d", place))
        transforms.append(Transform(parent, child, numbers[:3], numbers[3:]))
        place += numbers.nbytes
    return transforms


def _aligned(place: int, size: int) -> int:
    """Return the next place at which a number of a size may stand."""
    return BODY + (place - BODY + size - 1 & -size)


def _string(message: bytes, place: int) -> tuple[str, int]:
    """Return a string without its closing zero, and the place behind it."""
    place = _aligned(place, 4)
    (length,) = unpack_from(message, "I", place)
    (text,) = unpack_from(message, f"{length}s", place + 4)
    try:
        return text[:-1].decode(), place + 4 + length
    except UnicodeDecodeError:
        raise InputError("a message of transforms is damaged: the name of a frame is no text") from None


class TransformTree:
    """The newest transform of each frame to its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, Transform] = {}

    def add(self, message: bytes) -> None:
        """Take a serialised ``tf2_msgs/TFMessage``.

        Raises
        ------
        InputError
            When it is damaged.
        """
        self._parents |= {each.child.lstrip("/"): each for each in read_transforms(message)}

    def pose(self, frame: str, target: str) -> tuple[FloatArray, FloatArray] | None:
        """Return where a frame is in another: its origin (3,), metres, and the quaternion (4,) of its axes.

        Parameters
        ----------
        frame, target : str
            Names of frames, with or without a slash before them.

        Returns
        -------
        tuple of array or None
            None where no chain of transforms leads from one to the other.

        Raises
        ------
        InputError
            When a transform on the way has no rotation, or the chain is a circle.
        """
        above = self._ancestors(target.lstrip("/"))
        common = next((each for each in self._ancestors(frame.lstrip("/")) if each in above), None)
        if common is None:
            return None
        (position, turn), (origin, axes) = (self._in_ancestor(each.lstrip("/"), common) for each in (frame, target))
        rotation: FloatArray = (axes.inv() * turn).as_quat()
        return axes.inv().apply(position - origin), rotation

    def _ancestors(self, frame: str) -> list[str]:
        """Return a frame, its parent, and so on.

        Raises
        ------
        InputError
            When there is no end of them.
        """
        frames = [frame]
        while frame in self._parents:
            frame = self._parents[frame].parent.lstrip("/")
            if frame in frames:
                raise InputError(f"the transforms of tf lead from {frame} back to {frame}")
            frames.append(frame)
        return frames

    def _in_ancestor(self, frame: str, ancestor: str) -> "tuple[FloatArray, Rotation]":
        """Return where a frame is in one of its ancestors."""
        from scipy.spatial.transform import Rotation

        position, rotation = np.zeros(3), Rotation.identity()
        while frame != ancestor:
            transform = self._parents[frame]
            try:
                turn = Rotation.from_quat(transform.rotation)
            except ValueError:
                raise InputError(f"the rotation of {frame} in {transform.parent} is not a valid one in tf") from None
            position, rotation = turn.apply(position) + transform.position_m, turn * rotation
            frame = transform.parent.lstrip("/")
        return position, rotation
