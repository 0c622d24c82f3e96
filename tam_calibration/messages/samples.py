"""Samples of a recording with the exact stamps of their messages."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from tam_calibration.messages.usage import Usage
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, IntArray

Progress = Callable[[int, int], None]
"""Called now and then with the bytes that are done, and how many there are to do."""


_PIECE = 16_384


def pieces(sample_count: int) -> Iterator[slice]:
    """Yield the slices that cut so many samples into pieces, so that what is written of a piece stays small."""
    for start in range(0, sample_count, _PIECE):
        yield slice(start, min(start + _PIECE, sample_count))


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
