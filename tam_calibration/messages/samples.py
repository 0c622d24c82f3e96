"""Messages of streams and samples of recordings as arrays, and the turns and frames that the mounting gives them."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.cdr import COUNT
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.messages.usage import Usage
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import Mounting, Turn
from tam_calibration.model.recording import Recording
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
        if self.stamps_ns is None or not delay_ns:
            return self
        return replace(self, stamps_ns=self.stamps_ns - delay_ns)

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


Progress = Callable[[int, int], None]
"""Called now and then with the bytes that are done, and how many there are to do."""


def pieces(sample_count: int) -> Iterator[slice]:
    """Yield the slices that cut so many samples into pieces, so that what is written of a piece stays small."""
    for start in range(0, sample_count, COUNT):
        yield slice(start, min(start + COUNT, sample_count))


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of a recording.

    Parameters
    ----------
    recording : Recording
        The samples.
    stamps_ns : (N,) array of int, optional
        Stamps of their messages, nanoseconds; None where they were no messages.
    usage : Usage, optional
        How many of sensor 1's messages were used so far; None where they were no messages.
    missing : (N,) array of int, optional
        Which sensors each sample lacks, bit k for sensor k + 1; their readings are the mean of the others'. None
        where no sample lacks any.
    """

    recording: Recording
    stamps_ns: IntArray | None = None
    usage: Usage | None = None
    missing: IntArray | None = None


def stamps_of(time_s: FloatArray) -> IntArray:
    """Return times as whole nanoseconds.

    Raises
    ------
    InputError
        When a time cannot be the stamp of a message: before 1970 or after 2038.
    """
    if time_s[0] < 0 or time_s[-1] >= 2**31:
        raise InputError(
            f"the times {time_s[0]} to {time_s[-1]} s cannot be stamps of messages: they must lie between 0 and 2³¹ s"
        )
    seconds = np.floor(time_s)
    nanoseconds = np.rint((time_s - seconds) * 1e9)
    stamps_ns: IntArray = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)
    return stamps_ns


def seconds_of(stamps_ns: IntArray) -> FloatArray:
    """Return stamps in seconds, each rounded correctly: whole nanoseconds are beyond what doubles hold.

    From 1987 on the sum of seconds and fraction is: no fraction lies so near to the middle between two such doubles
    that its own rounding, 2⁻⁵⁴ at most, would carry it across.
    """
    seconds, fraction = np.divmod(stamps_ns, 1_000_000_000)
    # From here on the sum of seconds and fraction is rounded correctly.
    if len(stamps_ns) and seconds.min() >= 1 << 29:
        return np.asarray(seconds + fraction / 1e9)
    return np.array([stamp / 1_000_000_000 for stamp in stamps_ns.tolist()])
