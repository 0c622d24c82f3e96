"""Many messages of one stream as arrays, and the frames and turns that the mounting of the array gives them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.stream import sensor_stream
from tam_calibration.model.mounting import Mounting, Turn
from tam_calibration.model.units import FloatArray, IntArray

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class StreamMessages:
    """Messages of one stream.

    Parameters
    ----------
    order : (n,) array of int
        When each arrived among the batch's messages of all streams, increasing from 0.
    stamps_ns : (n,) array of int, optional
        Their stamps; None for a held channel without stamps.
    values : (n, width) array
        The values of the stream's columns.
    arrived_ns : (n,) array of int, optional
        When they arrived, by the clock of the recorder.
    """

    order: IntArray
    stamps_ns: IntArray | None
    values: FloatArray
    arrived_ns: IntArray | None = None

    @property
    def arrivals_ns(self) -> IntArray:
        """When each arrived, (n,); zeros where that is not known."""
        return np.zeros_like(self.order) if self.arrived_ns is None else self.arrived_ns

    def earlier(self, delay_ns: int) -> "StreamMessages":
        """Return the messages with stamps that are set back by a delay."""
        return self if self.stamps_ns is None else replace(self, stamps_ns=self.stamps_ns - delay_ns)

    def take(self, index: BoolArray) -> "StreamMessages":
        """Return the messages that a mask (n,) selects."""
        stamps_ns = None if self.stamps_ns is None else self.stamps_ns[index]
        return StreamMessages(self.order[index], stamps_ns, self.values[index], self.arrivals_ns[index])

    def turned(self, turn: Turn) -> "StreamMessages":
        """Return the messages with values that are turned."""
        return replace(self, values=np.column_stack(turn(*self.values.T)))

    @classmethod
    def concatenate(cls, parts: Sequence["StreamMessages"]) -> "StreamMessages":
        """Return messages that follow each other as one."""
        stamps = [part.stamps_ns for part in parts if part.stamps_ns is not None]
        return cls(
            np.concatenate([part.order for part in parts]),
            np.concatenate(stamps) if stamps else None,
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.arrivals_ns for part in parts]),
        )


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
