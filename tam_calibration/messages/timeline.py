"""Which stamps of a stream can be believed: one that jumps is either false or the first after a step of the clock.

The next message of the stream decides. When it goes on from before the jump, the stamp was false, and its message is
given up; when it follows the jump, a clock was set or a driver started anew, and both are taken. No clock is read.
"""

from typing import Generic, NamedTuple, TypeVar

import numpy as np

from tam_calibration.model.units import IntArray

STEP_NS = 250_000_000
"""Stamps of a stream that go back by less are out of order; those that go ahead by less are not doubted."""

_PERIODS = 16
"""A stream goes on within so many of its periods."""

_LONGEST_PERIOD_NS = 10_000_000_000
"""Of a stream that has sent a single message."""

_MOST_DOUBTFUL = 16
"""Messages that wait out of order for one that shows whether they are false."""

NEVER = 1 << 62
"""A stamp after all others, nanoseconds."""

Content = TypeVar("Content")


class StampStep(NamedTuple):
    """A step of the stamps of a stream.

    Parameters
    ----------
    stream : str
        Its name.
    size_ns : int
        How much later the stamps are than if they had gone on, nanoseconds; negative when they stepped back.
    """

    stream: str
    size_ns: int

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
        if self._goes_on(stamp_ns):
            self.give_up()
        elif self.doubtful and -self._disorder_ns < stamp_ns - self.doubtful[0][0] <= self._reach_of_doubtful_ns:
            self.doubtful.append(message)
            if stamp_ns > self.doubtful[0][0]:
                return self.believe()
            if len(self.doubtful) > _MOST_DOUBTFUL:
                self.give_up()
            return []
        elif not is_expected:
            self.give_up()
            self.doubtful = [message]
            return []
        self._move(stamp_ns)
        return [message]

    def _goes_on(self, stamp_ns: int) -> bool:
        return -self._disorder_ns < stamp_ns - self.newest_ns <= self.reach_ns

    @property
    def _reach_of_doubtful_ns(self) -> int:
        """How far ahead of the message that jumped the next may be: a stream that became slower jumps on as far."""
        jump_ns = self.doubtful[0][0] - self.newest_ns
        return max(self.reach_ns, 2 * jump_ns if jump_ns <= _LONGEST_PERIOD_NS else 0)

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
            period[:1] = _LONGEST_PERIOD_NS
        reach = np.maximum(STEP_NS, _PERIODS * np.minimum(period, NEVER // _PERIODS))
        return np.concatenate([[self.reach_ns], reach])[: len(stamps_ns)]

    def _move(self, stamp_ns: int) -> None:
        if stamp_ns > self.newest_ns:
            self._period_ns = stamp_ns - self.newest_ns if self.newest_ns >= 0 else 0
            self.reach_ns = max(STEP_NS, _PERIODS * (self._period_ns or _LONGEST_PERIOD_NS))
        if not self._is_late(stamp_ns):
            self.newest_ns = stamp_ns

    def _is_late(self, stamp_ns: int) -> bool:
        return -self._disorder_ns < stamp_ns - self.newest_ns <= 0
