"""SIGINT and SIGTERM: both end a process in order, at whatever time they come."""

import os
import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM)


@contextmanager
def held_back() -> Iterator[None]:
    """Hold the signals back from processes that are started in the block, until they ask for them.

    A process that is told to end while its interpreter still starts then ends as well as any other.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


class Startup:
    """The time in which a process loads its libraries: the signals end it at once, with exit code 0.

    There is nothing to put in order yet, and an exception could get lost in the libraries. When it is ``over``, the
    handlers of rclpy end the context; they call the one that was there before, which then does nothing.
    """

    def __init__(self) -> None:
        self._is_over = False
        _handle(self._end)

    def over(self) -> None:
        """Leave the signals to rclpy."""
        self._is_over = True

    def _end(self, number: int, frame: FrameType | None) -> None:
        if not self._is_over:
            os._exit(0)


def raise_exit(exit_code: int) -> None:
    """Let the signals raise SystemExit."""

    def end(number: int, frame: FrameType | None) -> None:
        raise SystemExit(exit_code)

    _handle(end)


def ignore() -> None:
    """Let nothing interrupt the end."""
    _handle(signal.SIG_IGN)


def _handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in ENDING:
        signal.signal(number, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
