"""SIGINT, SIGTERM and SIGHUP: each ends a process in order, at whatever time it comes."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import current_thread, main_thread
from types import FrameType

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

CODE_OF_SHELLS = 128
"""What shells add to the number of a signal for the exit code: 130 after Ctrl-C, 143 after SIGTERM."""


@contextmanager
def held_back() -> Iterator[None]:
    """Hold the signals back from processes that are started in the block, until they ask for them.

    A process that gets a signal while its interpreter still starts then ends as well as any other.
    """
    before = signal.pthread_sigmask(signal.SIG_BLOCK, ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def postponed() -> Iterator[None]:
    """Have a signal that comes in the block come when it is over.

    A mask would not do that: it holds for one thread, and a signal comes to any that does not block it. Python handles
    signals in the main thread alone: any other has nothing to postpone.
    """
    if current_thread() is not main_thread():
        yield
        return
    came: list[int] = []
    before = {each: signal.signal(each, lambda number, frame: came.append(number)) for each in ENDING}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        if came:
            signal.raise_signal(came[0])


class Ending:
    """What the signals do to a process: they end it.

    While it loads its libraries, at once: there is nothing to put in order yet, and an exception could get lost in the
    libraries. While it makes its nodes or does what a command shall do, by SystemExit. While nodes spin, by a word that
    is looked for between their callbacks: a context that ends in the middle of one, as with rclpy's own handlers, fails
    it in many ways, and while the executor of events takes on a node it even aborts the process.

    Where Python cannot raise it, as in the callback of an object that goes, it is raised a moment later.

    Parameters
    ----------
    exit_code : int, optional
        Of the process; by default that of shells, 128 and the number of the signal.

    Attributes
    ----------
    told : int or None
        The exit code, once a signal has come.
    """

    def __init__(self, exit_code: int | None = None) -> None:
        self.told: int | None = None
        self._exit_code = exit_code
        self._before = {number: signal.getsignal(number) for number in ENDING}
        self._unraisable = sys.unraisablehook
        sys.unraisablehook = self._raise_once_more
        self._exit: Callable[[int], object] | None = os._exit
        _handle(self._end)

    def loaded(self) -> None:
        """Have a signal raise SystemExit from now on."""
        self._exit = sys.exit

    def made(self) -> None:
        """Have a signal only be told by ``told`` from now on."""
        self._exit = None

    def release(self) -> None:
        """Have the signals do what they did before, where they still end this process."""
        sys.unraisablehook = self._unraisable
        for number, handler in self._before.items():
            if signal.getsignal(number) == self._end:
                signal.signal(number, handler)

    def _end(self, number: int, frame: FrameType | None) -> None:
        self.told = CODE_OF_SHELLS + number if self._exit_code is None else self._exit_code
        if self._exit is not None:
            self._exit(self.told)

    def _raise_once_more(self, unraisable: "sys.UnraisableHookArgs") -> None:
        if not isinstance(unraisable.exc_value, SystemExit):
            self._unraisable(unraisable)
            return
        code = unraisable.exc_value.code

        def end(number: int, frame: FrameType | None) -> None:
            raise SystemExit(code)

        signal.signal(signal.SIGALRM, end)
        # After which an ending that was lost is raised again, seconds: what lost it, as a collection of garbage,
        # is over.
        signal.setitimer(signal.ITIMER_REAL, 0.01)


def ignore() -> None:
    """Let nothing interrupt the end, and nothing hold it up for long: then the kernel ends the process."""
    _handle(signal.SIG_IGN)
    signal.signal(signal.SIGALRM, signal.SIG_DFL)
    # Time within which a process that puts itself in order ends.
    signal.alarm(5)


def _handle(handler: Callable[[int, FrameType | None], None] | signal.Handlers) -> None:
    for number in ENDING:
        if number != signal.SIGHUP or signal.getsignal(number) != signal.SIG_IGN:  # as nohup leaves it
            signal.signal(number, handler)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, ENDING)
