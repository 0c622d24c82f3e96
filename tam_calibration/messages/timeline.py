"""The stamps of a stream: which can be believed, the time of a run that they give, and their rate and delay.

A stamp that jumps is either false or the first after a step of the clock. The next message of the stream decides. If
it continues from before the jump, the stamp was false, and its message is dropped. If it follows the jump, a clock was
set or a driver started again, and both are taken. No clock is read.
"""

from collections import deque
from collections.abc import Hashable
from typing import Generic, NamedTuple, TypeVar

import numpy as np

from tam_calibration.model.units import IntArray

STEP_NS = 250_000_000
"""Stamps of a stream that go back by less are out of order; those that go ahead by less are not doubted."""

_PERIODS = 16
"""A stream goes on within so many of its periods."""

LONGEST_PERIOD_NS = 10_000_000_000
"""Of a stream that has sent a single message: no array is read more rarely."""


NEVER = 1 << 62
"""A stamp after all others, nanoseconds."""

Content = TypeVar("Content")


class StampStep(NamedTuple):
    """A step of the stamps of a stream, or a pause of its messages.

    Parameters
    ----------
    stream : str
        Its name.
    size_ns : int
        How much later the stamps are than if they had gone on, nanoseconds; negative when they stepped back.
    is_pause : bool
        Whether the messages came later too.
    """

    stream: str
    size_ns: int
    is_pause: bool = False

    @property
    def sentence(self) -> str:
        """The step and its cause, or the pause, for people."""
        if self.is_pause:
            return f"no messages of {self.stream} for {self.size_ns / 1e9:.1f} s"
        return f"{self}: a clock was set or a driver started anew, the run is kept"

    def __str__(self) -> str:
        """Return the step as a clause for people."""
        direction = "back" if self.size_ns < 0 else "ahead"
        return f"the stamps of {self.stream} stepped {direction} by {abs(self.size_ns) / 1e9:.6g} s"


class Timeline(Generic[Content]):
    """The stamps of one stream.

    Parameters
    ----------
    disorder_ns : int
        Stamps that go back by less are no jump.

    Attributes
    ----------
    newest_ns : int
        The newest stamp that is believed, nanoseconds.
    reach_ns : int
        How far ahead of it the next may be.
    doubtful : list of tuple of int and content
        Stamp and content of the message that jumped last, until it is believed or given up, and of those that came
        after it a little out of order.
    jump_ns : int
        Size of the jump that was believed last.
    given_up : int
        Number of messages whose stamps were false.
    """

    def __init__(self, disorder_ns: int = STEP_NS) -> None:
        self.newest_ns, self.reach_ns = -1, NEVER
        self.doubtful: list[tuple[int, Content]] = []
        self.jump_ns = self.given_up = 0
        self._disorder_ns, self._period_ns = disorder_ns, 0

    def advances(self, stamp_ns: int) -> bool:
        """Move on to a stamp that is later and no jump, and return whether it is, with none before it in doubt."""
        period = stamp_ns - self.newest_ns
        if self.doubtful or not 0 < period <= self.reach_ns or self.newest_ns < 0:
            return False
        self.newest_ns, self._period_ns = stamp_ns, period
        self.reach_ns = _PERIODS * period if period > STEP_NS // _PERIODS else STEP_NS
        return True

    def take(self, stamp_ns: int, content: Content, is_expected: bool = False) -> list[tuple[int, Content]]:
        """Return the messages that are believed now: the next one, before it those that were doubtful, or none.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the next message, nanoseconds.
        content : object
            What it carries.
        is_expected : bool
            Whether other streams make a jump to this stamp credible.
        """
        message = stamp_ns, content
        if -self._disorder_ns < stamp_ns - self.newest_ns <= self.reach_ns:
            self.give_up()
        elif self.doubtful and -self._disorder_ns < stamp_ns - self.doubtful[0][0] <= self._reach_of_doubtful_ns:
            self.doubtful.append(message)
            if stamp_ns > self.doubtful[0][0]:
                return self.believe()
            if len(self.doubtful) > 16:
                self.give_up()
            return []
        elif not is_expected:
            self.give_up()
            self.doubtful = [message]
            return []
        self._move(stamp_ns)
        return [message]

    @property
    def _reach_of_doubtful_ns(self) -> int:
        """How far ahead of the message that jumped the next may be: a stream that became slower jumps on as far."""
        jump_ns = self.doubtful[0][0] - self.newest_ns
        return max(self.reach_ns, 2 * jump_ns if jump_ns <= LONGEST_PERIOD_NS else 0)

    def believe(self) -> list[tuple[int, Content]]:
        """Return the doubtful messages, which are believed now."""
        believed, self.doubtful = self.doubtful, []
        self.jump_ns = believed[0][0] - self.newest_ns - self._period_ns
        for stamp_ns, _ in believed:
            self._move(stamp_ns)
        return believed

    def give_up(self) -> None:
        """Give up the doubtful messages, as none will follow them."""
        self.given_up += len(self.doubtful)
        self.doubtful = []

    def rise(self, stamps_ns: IntArray) -> None:
        """Move on by rising stamps that are believed."""
        for stamp_ns in stamps_ns[-2:].tolist():
            self._move(stamp_ns)

    def reaches(self, stamps_ns: IntArray) -> IntArray:
        """Return how far ahead of the one before it each of the next stamps may be if they rise and go on."""
        period = np.diff(stamps_ns[:-1], prepend=self.newest_ns)
        if self.newest_ns < 0:
            period[:1] = LONGEST_PERIOD_NS
        reach = np.maximum(STEP_NS, _PERIODS * np.minimum(period, NEVER // _PERIODS))
        return np.concatenate([[self.reach_ns], reach])[: len(stamps_ns)]

    def _move(self, stamp_ns: int) -> None:
        if stamp_ns > self.newest_ns:
            self._period_ns = stamp_ns - self.newest_ns if self.newest_ns >= 0 else 0
            self.reach_ns = max(STEP_NS, _PERIODS * (self._period_ns or LONGEST_PERIOD_NS))
        if not -self._disorder_ns < stamp_ns - self.newest_ns <= 0:
            self.newest_ns = stamp_ns


class Run:
    """One run of samples, in the order in which they come."""

    def __init__(self) -> None:
        self.start_over()

    def start_over(self) -> None:
        """Begin a new run with the next sample."""
        self._first: tuple[int, Hashable] | None = None
        self._newest_ns: int | None = None
        # Time, at most, from the last sample before a step to the first after it.
        self._shift_ns, self._period_ns = 0, 1_000_000_000

    def resume(self, stamp_ns: int, values: Hashable, newest_ns: int, shift_ns: int) -> None:
        """Go on with a run of which another process knew the beginning.

        Parameters
        ----------
        stamp_ns : int
            Stamp of its first sample, nanoseconds.
        values : hashable
            The readings of that sample.
        newest_ns : int
            Time of its last sample, nanoseconds.
        shift_ns : int
            How much later that time is than the sample's stamp, nanoseconds.
        """
        self._first, self._newest_ns, self._shift_ns = (stamp_ns, values), newest_ns, shift_ns

    def begins_again(self, stamp_ns: int, values: Hashable) -> bool:
        """Return whether the first sample comes again, to the last bit: a recording that is played once more.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the next sample, nanoseconds.
        values : hashable
            Its readings.
        """
        if self._first is None:
            self._first = stamp_ns, values
            return False
        if stamp_ns != self._first[0] or values != self._first[1]:
            return False
        self.start_over()
        self._first = stamp_ns, values
        return True

    def time_ns(self, stamp_ns: int) -> int:
        """Return the time of the next sample, nanoseconds: its stamp, without the steps back before it."""
        time_ns = stamp_ns + self._shift_ns
        if self._newest_ns is not None:
            if time_ns <= self._newest_ns:
                time_ns = self._newest_ns + self._period_ns
                self._shift_ns = time_ns - stamp_ns
            self._period_ns = min(self._period_ns, time_ns - self._newest_ns)
        self._newest_ns = time_ns
        return time_ns


_REMEMBERED = 256
"""Messages of a stream that count: some seconds of a usual driver."""

_FEWEST = 3
"""Messages of a driver that tell something of it."""


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
        # Beyond it the stamps are of another clock, as in a bag that is played.
        if abs(delay_s) < 60.0:
            figures["delay_ms"] = f"{1e3 * delay_s:.3g}"
        if pace is not self and (offsets := _offsets_s(stamps, np.sort(pace._stamps_ns))) is not None:
            figures["offset_ms"] = f"{1e3 * np.median(offsets):.3g} (at most {1e3 * np.abs(offsets).max():.3g})"
        return figures


def _offsets_s(stamps_ns: np.ndarray, pace_ns: np.ndarray) -> np.ndarray | None:
    """Return the distances (n,) of stamps to the nearest one of sensor 1, of those between two of these; seconds."""
    inside = stamps_ns[(stamps_ns >= pace_ns[0]) & (stamps_ns <= pace_ns[-1])] if len(pace_ns) > 1 else stamps_ns[:0]
    if not len(inside):
        return None
    apart = inside[:, None] - pace_ns
    return np.asarray(1e-9 * apart[np.arange(len(inside)), np.abs(apart).argmin(axis=1)])
