"""One action at a time in a thread of its own, so that its node goes on meanwhile."""

import ctypes
import gc
import math
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


class Work:
    """The actions of a node in addition to its stream; they return their memory.

    rclpy's executor with threads would do the same at the cost of a core.
    """

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(max_workers=1)
        self._name, self._done = "", math.nan

    @property
    def busy_with(self) -> str:
        """The action that is under way and how far it is, for people; empty when there is none."""
        return self._name if math.isnan(self._done) else f"{self._name}, {self._done:.0%} done"

    def begin(self, name: str, action: Callable[[], Result], answer: Callable[[Result], None]) -> None:
        """Do an action; when `busy_with` is not empty it waits for the one before.

        Parameters
        ----------
        name : str
            For `busy_with`.
        action : callable
            Returns a result.
        answer : callable
            Called with the result, once the next action may begin.
        """
        self._name, self._done = name, math.nan
        self._thread.submit(self._do, action, answer)

    def _do(self, action: Callable[[], Result], answer: Callable[[Result], None]) -> None:
        try:
            result = action()
        finally:
            self._name, self._done = "", math.nan
        answer(result)
        del result
        _give_back_memory()

    def progress(self, done: float) -> None:
        """Note how far the action is: from 0 to 1."""
        self._done = done


def _give_back_memory() -> None:
    """Return to the system what the allocator keeps."""
    gc.collect()
    if sys.platform == "linux":
        ctypes.CDLL(None).malloc_trim(0)
