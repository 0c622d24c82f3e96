"""What the last stamps of a stream tell of its driver: rate, jitter, delay, and how far it reads from sensor 1."""

from collections import deque

import numpy as np

_REMEMBERED = 256
"""Messages of a stream that count: some seconds of a usual driver."""

_FEWEST = 3
"""Messages of a driver that tell something of it."""

_LONGEST_DELAY_S = 60.0
"""Seconds; beyond, stamps are of another clock than this computer's, such as those of a bag that is played."""


class StampFigures:
    """The last stamps of one stream, and when they arrived."""

    def __init__(self) -> None:
        self._stamps_ns: deque[int] = deque(maxlen=_REMEMBERED)
        self._arrivals_ns: deque[int] = deque(maxlen=_REMEMBERED)

    def add(self, stamp_ns: int, arrival_ns: int) -> None:
        """Take a message.

        Parameters
        ----------
        stamp_ns : int
            Of its header, nanoseconds.
        arrival_ns : int
            Time of this computer when it arrived, nanoseconds since 1970.
        """
        self._stamps_ns.append(stamp_ns)
        self._arrivals_ns.append(arrival_ns)

    @property
    def are_zero(self) -> bool:
        """Whether all stamps are zero, those of three messages or more: the driver does not stamp them."""
        return len(self._stamps_ns) >= _FEWEST and not any(self._stamps_ns)

    @property
    def interval_ns(self) -> float:
        """The median interval of the stamps, nanoseconds, of two messages or more."""
        return float(np.median(np.diff(self._stamps_ns)))

    def summary(self, pace: "StampFigures") -> dict[str, str]:
        """Return the figures for people, by name; those that the messages do not tell yet are left out.

        ``rate_hz``; ``jitter_ms``, the standard deviation of the intervals; ``delay_ms``, the median time from stamp to
        arrival; ``offset_ms``, the median and the largest distance to the nearest stamp of sensor 1.

        Parameters
        ----------
        pace : StampFigures
            Those of sensor 1.
        """
        stamps = np.array(self._stamps_ns)
        if len(stamps) < _FEWEST:
            return {}
        intervals = 1e-9 * np.diff(stamps)
        delay_s = 1e-9 * float(np.median(np.array(self._arrivals_ns) - stamps))
        figures = {
            "rate_hz": f"{1e9 / max(self.interval_ns, 1):.4g}",
            "jitter_ms": f"{1e3 * float(np.std(intervals)):.3g}",
        }
        if abs(delay_s) < _LONGEST_DELAY_S:
            figures["delay_ms"] = f"{1e3 * delay_s:.3g}"
        if pace is not self and (offsets := _offsets_s(stamps, np.sort(pace._stamps_ns))) is not None:
            figures["offset_ms"] = f"{1e3 * np.median(offsets):.3g} (at most {1e3 * np.abs(offsets).max():.3g})"
        return figures


def _offsets_s(stamps_ns: np.ndarray, pace_ns: np.ndarray) -> np.ndarray | None:
    """Return the distances (n,) of stamps to the nearest one of sensor 1, of those between two of these; seconds."""
    inside = stamps_ns[(stamps_ns >= pace_ns[0]) & (stamps_ns <= pace_ns[-1])] if len(pace_ns) > 1 else stamps_ns[:0]
    if not len(inside):
        return None
    after = np.clip(np.searchsorted(pace_ns, inside), 1, len(pace_ns) - 1)
    apart = np.stack([inside - pace_ns[after - 1], inside - pace_ns[after]])
    offsets: np.ndarray = 1e-9 * np.take_along_axis(apart, np.abs(apart).argmin(axis=0)[None], axis=0)[0]
    return offsets
