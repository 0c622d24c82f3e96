"""Joining outputs with the attitude of the sample that they came from: the stamps of both are the same."""

from collections import deque
from typing import NamedTuple

from tam_calibration.model.units import FloatArray

LONGEST_WAIT = 100
"""Outputs that wait for their sample; the oldest beyond these goes on without attitude."""


class Joined(NamedTuple):
    """Outputs with their stamp and attitude; None where the attitude did not come."""

    stamp_ns: int
    outputs: FloatArray
    attitude: FloatArray | None


class AttitudeJoin:
    """Joins two streams, each in the order of its stamps until one of them starts over.

    Everything that is pushed as outputs comes out once, with or without attitude.
    """

    def __init__(self) -> None:
        self._attitudes: dict[int, FloatArray] = {}
        self._waiting: deque[tuple[int, FloatArray]] = deque()
        self._newest_attitude = self._newest_outputs = -1

    def push_attitude(self, stamp_ns: int, attitude: FloatArray) -> list[Joined]:
        """Take the attitude of a sample and return the outputs that waited for it.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the sample, nanoseconds; one that does not rise begins a new run.
        attitude : (4,) array
            Quaternion x, y, z, w that turns the array frame into the world.
        """
        if stamp_ns <= self._newest_attitude:
            self._attitudes.clear()
        self._newest_attitude = stamp_ns
        self._attitudes[stamp_ns] = attitude
        if len(self._attitudes) > 1000:  # that wait for their outputs
            del self._attitudes[next(iter(self._attitudes))]
        return self._drain()

    def push_outputs(self, stamp_ns: int, outputs: FloatArray) -> list[Joined]:
        """Take the outputs of a sample and return those that need not wait.

        Parameters
        ----------
        stamp_ns : int
            Stamp of the sample, nanoseconds; one that does not rise begins a new run.
        outputs : (18,) array
            Row of ``field_gradient``: nine outputs, T and T/m, and their standard errors.
        """
        joined = []
        if stamp_ns <= self._newest_outputs:  # a new run: what still waits is of the old one
            joined = [self._join(*self._waiting.popleft()) for _ in range(len(self._waiting))]
            if stamp_ns not in self._attitudes:
                self._newest_attitude = -1
        self._newest_outputs = stamp_ns
        self._waiting.append((stamp_ns, outputs))
        return joined + self._drain()

    def _drain(self) -> list[Joined]:
        joined = []
        while self._waiting and self._is_answerable(self._waiting[0][0]):
            joined.append(self._join(*self._waiting.popleft()))
        return joined

    def _is_answerable(self, stamp_ns: int) -> bool:
        return stamp_ns in self._attitudes or stamp_ns < self._newest_attitude or len(self._waiting) > LONGEST_WAIT

    def _join(self, stamp_ns: int, outputs: FloatArray) -> Joined:
        return Joined(stamp_ns, outputs, self._attitudes.pop(stamp_ns, None))
