"""The processor time of the processes below this one, whoever started them."""

import os
from pathlib import Path
from threading import Event, Thread
from types import TracebackType

PERIOD_S = 0.1


class ProcessTimes:
    """Watches, while it is open, all processes below this one; what they used before does not count."""

    def __init__(self) -> None:
        self._begin: dict[int, float] = {}
        self._end: dict[int, float] = {}
        self._closing = Event()
        self._thread = Thread(target=self._watch)

    def __enter__(self) -> "ProcessTimes":
        """Begin to watch."""
        self._begin = _seconds_below(os.getpid())
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End it."""
        self._closing.set()
        self._thread.join()

    def busiest_s(self, count: int) -> list[float]:
        """Return the times of the processes that used most, the most first; their last tenth of a second may lack."""
        used = (end - self._begin.get(process, 0.0) for process, end in self._end.items())
        return sorted(used, reverse=True)[:count]

    def _watch(self) -> None:
        while not self._closing.wait(PERIOD_S):
            self._end |= _seconds_below(os.getpid())


def _seconds_below(top: int) -> dict[int, float]:
    """Return the processor times of the processes below one, by their numbers."""
    parents, seconds = {}, {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        process = int(path.parent.name)
        parents[process] = int(fields[1])
        seconds[process] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return {process: used for process, used in seconds.items() if _is_below(process, top, parents)}


def _is_below(process: int, top: int, parents: dict[int, int]) -> bool:
    while process in parents:
        process = parents[process]
        if process == top:
            return True
    return False
