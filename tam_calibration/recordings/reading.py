"""How a recording is read: by which map, which part of it, with which tolerance."""

from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from re import fullmatch

import numpy as np
from numpy.typing import NDArray

from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import IntArray
from tam_calibration.recordings.channel_map import ChannelMap
from tam_calibration.recordings.times import nanoseconds_of

TOLERANCE_S = 0.0
"""Difference of stamps up to which readings count as of one moment; beyond it they are interpolated."""


@dataclass(frozen=True)
class Moment:
    """A time in a recording: from its start, or of day.

    Parameters
    ----------
    time_ns : int
        Nanoseconds from the start of the recording, or since 1970.
    is_absolute : bool
        Whether it is since 1970.
    """

    time_ns: int
    is_absolute: bool

    @classmethod
    def of(cls, words: str | float) -> "Moment":
        """Return what is meant by seconds from the start or an ISO 8601 time; one without a zone is UTC.

        Raises
        ------
        InputError
            When it is neither.
        """
        if isinstance(words, str) and not fullmatch(r"\s*[-+]?\d*\.?\d+(e[-+]?\d+)?\s*", words, flags=2):
            try:
                moment = datetime.fromisoformat(words)
            except ValueError:
                raise InputError(
                    f"{quoted(words)} is no time: give seconds from the start such as 12.5, or 2026-06-01T12:00:00"
                ) from None
            return cls(nanoseconds_of(moment), True)
        seconds = float(words)
        if not 0 <= seconds < 9e9:
            raise InputError(f"{seconds:g} s from the start is no time in a recording: give 0 or more")
        return cls(round(seconds * 1e9), False)

    def since_epoch(self, first_ns: int) -> int:
        """Return it on the clock of the stamps.

        Parameters
        ----------
        first_ns : int
            First stamp of the recording, nanoseconds.

        Raises
        ------
        InputError
            When it is of day, and the stamps are not.
        """
        if not self.is_absolute:
            return first_ns + self.time_ns
        # Stamps before March 1973 count from when something was switched on.
        if first_ns < 10**17:
            raise InputError("its times are no times of day: give --from and --until in seconds from the start")
        return self.time_ns


@dataclass(frozen=True)
class Window:
    """The part of a recording that is read: from one moment until another."""

    start: Moment | None = None
    end: Moment | None = None

    def contains(self, stamps_ns: IntArray, first_ns: int) -> NDArray[np.bool_]:
        """Return which stamps (n,) lie within; the end belongs to it.

        Parameters
        ----------
        stamps_ns : (n,) array of int
            Nanoseconds.
        first_ns : int
            First stamp of the recording.
        """
        inside = np.ones(len(stamps_ns), dtype=bool)
        if self.start is not None:
            inside &= stamps_ns >= self.start.since_epoch(first_ns)
        if self.end is not None:
            inside &= stamps_ns <= self.end.since_epoch(first_ns)
        return inside


@dataclass(frozen=True)
class Reading:
    """How a recording is read.

    Parameters
    ----------
    channel_map : ChannelMap, optional
        Which topics or columns are what; without one the choice is made from what the recording contains.
    window : Window
        The part that is read.
    unwrap : bool
        Whether overflows of a sensor's counter are taken out.
    base_station : Path, optional
        IAGA-2002 file, from which the intensity is taken where the recording has none.
    tolerance_s : float
        Greatest difference of stamps within a sample, seconds.
    files : tuple of Path
        What was read for it, which no output may replace.
    origin : tuple of float, optional
        Latitude and longitude, degrees, and height, metres, from which geographic positions count; from their first
        where it is not given.
    """

    channel_map: ChannelMap | None = None
    window: Window = field(default_factory=Window)
    unwrap: bool = False
    base_station: Path | None = None
    tolerance_s: float = TOLERANCE_S
    files: tuple[Path, ...] = ()
    origin: tuple[float, float, float] | None = None


AS_IT_IS = Reading()
"""The complete recording, without a map."""
