"""The samples of one run: its time goes on where the stamps step back, and it begins again with its first sample."""

from collections.abc import Hashable

_LONGEST_STEP_NS = 1_000_000_000
"""Time, at most, from the last sample before a step to the first after it."""


class Run:
    """One run of samples, in the order in which they come."""

    def __init__(self) -> None:
        self.start_over()

    def start_over(self) -> None:
        """Begin a new run with the next sample."""
        self._first: tuple[int, Hashable] | None = None
        self._newest_ns: int | None = None
        self._shift_ns, self._period_ns = 0, _LONGEST_STEP_NS

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
