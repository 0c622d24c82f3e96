"""Which messages of a queue join which samples of a batch, or what the messages around a sample interpolate to."""

import numpy as np

from tam_calibration.core.interpolation import interpolated
from tam_calibration.messages.batch_queue import EARLIER, Queue
from tam_calibration.messages.samples import BoolArray
from tam_calibration.messages.stream import HeldStream, InterpolatedStream, OnceStream
from tam_calibration.messages.timeline import NEVER
from tam_calibration.model.units import FloatArray, IntArray


class Match:
    """Which message of a stream joins each sample, and whether one does, or else what those around it tell.

    Parameters
    ----------
    queue : Queue
        The messages.
    keys : (n,) array of int
        Stamps of the samples, rising, nanoseconds.
    shortest_ns : (n,) array of int
        The shortest interval of samples before each, nanoseconds; 0 where it is not known.

    Attributes
    ----------
    found : (n,) array of bool
        The samples that a message joins.
    told : (n,) array of bool
        Others, of which the messages around them tell.
    is_doubtful : (n,) array of bool
        Whether the message may have been the next sample's, which only the next message of sensor 1 decides.
    """

    def __init__(self, queue: Queue, keys: IntArray, shortest_ns: IntArray) -> None:
        self.queue, self._keys = queue, keys
        self._windows_ns = queue.windows_ns(shortest_ns)
        self._index = np.zeros(len(keys), dtype=np.int64)
        self.found, self.told, self.is_doubtful = (np.zeros(len(keys), dtype=bool) for _ in range(3))
        if not len(queue.keys):
            return
        if queue.is_held:
            self._hold(np.searchsorted(queue.keys, keys, "right") - 1)
        elif np.array_equal(queue.keys[: len(keys)], keys):
            self._index, self.found = np.arange(len(keys)), ~self.found
        else:
            after = np.minimum(np.searchsorted(queue.keys, keys), len(queue.keys) - 1)
            before = np.maximum(after - 1, 0)
            is_before = keys - queue.keys[before] <= np.abs(queue.keys[after] - keys)
            self._index = np.where(is_before, before, after)
            self.found = np.abs(queue.keys[self._index] - keys) <= self._windows_ns

    def _hold(self, index: IntArray) -> None:
        """Have held messages at some places (n,) of the queue join, -1 for none, as far as they are not too old."""
        self.found = (index >= 0) & (self._keys - self.queue.keys[index] <= self._windows_ns)
        self._index = np.maximum(index, 0)

    @property
    def has_value(self) -> BoolArray:
        """(n,) whether each sample has a value of the stream."""
        return self.found | self.told

    def leave_to_next(self, following: IntArray, shortest_ns: IntArray) -> bool:
        """Leave messages to the next sample where they are nearer to it; return whether that is known of all.

        Parameters
        ----------
        following : (n,) array of int
            Stamp of the message of sensor 1 after each sample; ``NEVER`` where it has not come.
        shortest_ns : (n,) array of int
            The shortest interval of samples before each, nanoseconds.
        """
        if not self.found.any() or self.queue.is_held:
            return True
        later_ns = self.queue.keys[self._index] - self._keys
        self.is_doubtful = self.found & (later_ns > 0) & (2 * later_ns >= shortest_ns)
        self.found = self.found & ~(self.is_doubtful & (np.abs(following - self._keys - later_ns) < later_ns))
        return not (self.is_doubtful & (following == NEVER)).any()

    def interpolate(self) -> None:
        """Find what the messages around the other samples tell of a sensor."""
        if self.found.all() or not isinstance(self.queue.stream, InterpolatedStream):
            return
        stamps, order, values = self.queue.with_past()
        self._told_values, after, self._weights = interpolated(stamps, values, self._keys[~self.found])
        self.told[~self.found] = after < len(stamps)
        self._arrival, self._after = np.append(order, EARLIER)[after], after[after < len(stamps)]

    def wanted_twice(self, is_sample: BoolArray) -> bool:
        """Whether a message joins a sample that a later one wants too."""
        index, joins = self._index[self.found], is_sample[self.found]
        return not self.queue.is_held and bool((joins[:-1] & (index[1:] == index[:-1])).any())

    def is_late(self, moments: IntArray) -> bool:
        """Whether a message after a sample came later than at the sample's moment."""
        return bool(self.told.any() and (self._arrival > moments[~self.found]).any())

    def arrive_until(self, order: IntArray) -> None:
        """Have only those held messages join that had arrived when each sample was complete, among the arrivals."""
        latest = np.searchsorted(self.queue.order_of_keys, order, "right") - 1
        self._hold(np.minimum(np.where(self.found, self._index, -1), latest))

    def join_once(self, is_sample: BoolArray) -> None:
        """Have messages without stamps join one of the samples each, as an `OnceStream` lets them."""
        stream = self.queue.stream
        if not isinstance(stream, OnceStream):
            return
        newest = np.maximum.accumulate(np.where(self.found, self._index, -1)[is_sample])
        before = np.concatenate([[-1], newest[:-1]])[: len(newest)]
        oldest = np.searchsorted(self.queue.keys, self._keys[is_sample] - stream.window_ns)
        count = np.maximum(newest + 1 - np.maximum(oldest, before + 1), 0)
        # One message waits on after a sample to which two came, until one comes to which none does.
        is_fresh = oldest <= before
        decisive = np.maximum.accumulate(np.where((count != 1) | ~is_fresh, np.arange(len(count)), 0))
        waits_on = (count >= 2)[decisive]
        count += np.concatenate([[False], waits_on[:-1]])[: len(count)] & is_fresh
        self._index[is_sample] = np.maximum(newest - (count >= 2), 0)
        self.found = np.zeros_like(self.found)
        self.found[is_sample] = count >= 1

    def values(self, is_sample: BoolArray) -> FloatArray:
        """Return the values that join the samples; NaN where there are none."""
        found = self.found[is_sample]
        if found.any():
            values = self.queue.values[self._index[is_sample]]
            values[~found] = np.nan
        else:
            values = np.full((len(found), self.queue.values.shape[1]), np.nan)
        if self.told.any():
            values[~found] = self._told_values[is_sample[~self.found]]
        return values

    def keep(self, is_sample: BoolArray) -> None:
        """Count what joined the samples, and let the stream wait with what may still join one."""
        stream, queue, joined = self.queue.stream, self.queue, self._index[self.found & is_sample]
        first = 0
        if len(self._keys) and isinstance(stream, HeldStream):
            first = int(np.searchsorted(queue.keys, self._keys[-1], "right")) - stream.kept
        elif len(self._keys):
            first = int(np.searchsorted(queue.keys, self._keys[-1] - self._windows_ns[-1]))
        if len(joined) and (isinstance(stream, OnceStream) or not queue.is_held):
            first = max(first, int(joined[-1]) + 1)
        queue.keep(max(first, 0), len(joined))
        if isinstance(stream, InterpolatedStream) and self.told.any():
            stream.interpolated += int((self.told & is_sample).sum())
            stream.correlation().add(self._after, self._weights)
