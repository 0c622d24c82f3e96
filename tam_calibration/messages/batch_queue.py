"""The messages of a batch, stream by stream, and which of them join which samples: searches in sorted stamps."""

from collections import deque
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from tam_calibration.core.interpolation import BEFORE, interpolated
from tam_calibration.messages.samples import BoolArray, StreamMessages
from tam_calibration.messages.stream import HeldStream, IntensityStream, InterpolatedStream, Message, OnceStream, Stream
from tam_calibration.messages.timeline import NEVER, STEP_NS
from tam_calibration.model.units import FloatArray, IntArray

LONG_AGO = -NEVER
"""A stamp before all others."""

EARLIER = LONG_AGO
"""The moment of arrival of what came before a batch."""

_NONE = np.array([], dtype=np.int64)


class Arrivals:
    """When the sensors' messages of a batch arrived, in order and in time, and the newest stamp of any sensor then.

    Parameters
    ----------
    sensors : sequence of StreamMessages
        What came of each sensor in the batch; none of a sensor that was silent.
    newest_ns : int
        Newest stamp of any sensor before the batch, nanoseconds; ``LONG_AGO`` before the first.
    """

    def __init__(self, sensors: Sequence[StreamMessages], newest_ns: int) -> None:
        order = np.concatenate([_NONE, *(each.order for each in sensors)])
        stamps = np.concatenate([_NONE, *(each.stamps_ns for each in sensors if each.stamps_ns is not None)])
        arrived = np.concatenate([_NONE, *(each.arrivals_ns for each in sensors)])
        in_order = np.argsort(order, kind="stable")
        self._order, self._arrived_ns, self._newest_of_earlier_ns = order[in_order], arrived[in_order], newest_ns
        self.newest_ns: IntArray = np.maximum(np.maximum.accumulate(stamps[in_order]), newest_ns)

    def rises(self) -> tuple[IntArray, IntArray]:
        """Return the stamps (n,) that are newer than all before, and when they arrived."""
        rises = np.diff(self.newest_ns, prepend=self._newest_of_earlier_ns) > 0
        return self.newest_ns[rises], self._arrived_ns[rises]

    def newest_before(self, order: IntArray) -> IntArray:
        """Return the newest stamp of any sensor before each moment."""
        return np.concatenate([[self._newest_of_earlier_ns], self.newest_ns])[np.searchsorted(self._order, order)]

    def reach(self, stamps_ns: IntArray) -> IntArray:
        """Return when the sensors reached each stamp."""
        moment = np.append(self._order, NEVER)[np.searchsorted(self.newest_ns, stamps_ns)]
        return np.where(stamps_ns <= self._newest_of_earlier_ns, EARLIER, moment)


class Queue:
    """The messages of a stream: what came, and what of it and of the messages before may join a sample.

    Parameters
    ----------
    stream : Stream
        Its buffer contains what waits from earlier batches.
    messages : StreamMessages or None
        What came of it in this batch; None where nothing did.
    arrivals : Arrivals
        Of the sensors in this batch; a message without a stamp takes the sensors' newest stamp at its arrival.

    Attributes
    ----------
    stamps_ns, order : (m,) array of int
        Stamps of what came, for messages without stamps those that they take, and when it came.
    is_new : (m,) array of bool
        Whether each is neither repeated nor late.
    keys, order_of_keys : (n,) array of int
        Stamps of what may join, rising, and when it came.
    values : (n, width) array
        Its values.
    """

    def __init__(self, stream: Stream, messages: StreamMessages | None, arrivals: Arrivals) -> None:
        messages = messages or StreamMessages(_NONE, _NONE, np.zeros((0, stream.width)))
        self.stream, self.order, self._came = stream, messages.order, messages.values
        self.is_unstamped = messages.stamps_ns is None
        self.stamps_ns = arrivals.newest_before(self.order) if messages.stamps_ns is None else messages.stamps_ns
        newest = np.concatenate([[max(stream.newest, LONG_AGO)], self.stamps_ns])
        self._previous_ns = np.maximum.accumulate(newest)[:-1]
        self.is_new: BoolArray = (self.stamps_ns > self._previous_ns) | self.is_unstamped
        new = slice(None) if self.is_new.all() else self.is_new
        came = self.stamps_ns[new], self.order[new], self._came[new]
        self.keys, self.order_of_keys, self.values = _after(stream.buffer, *came)

    def jumps(self, arrivals: Arrivals) -> bool:
        """Whether a stamp jumps that the sensors do not make credible, or one before it is doubtful."""
        timeline, new = self.stream.timeline, self.stamps_ns[self.is_new]
        is_back = self.stamps_ns <= self._previous_ns - STEP_NS
        is_far = np.diff(new, prepend=timeline.newest_ns) > timeline.reaches(new)
        is_alone = new > arrivals.newest_before(self.order[self.is_new]) + STEP_NS
        return bool(timeline.doubtful) or bool(is_back.any() or (is_far & is_alone).any())

    @property
    def is_held(self) -> bool:
        """Whether a message is valid until the next."""
        return isinstance(self.stream, HeldStream)

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest message that ever came."""
        return int(self.keys[-1]) if self.is_new.any() else self.stream.newest

    @property
    def decided_until_ns(self) -> int:
        """Last stamp at which the stream's own messages decide what joins a sample."""
        if self.is_held or len(self.keys):
            return self.newest_ns
        return self.newest_ns - self.stream.window_ns

    def windows_ns(self, shortest_ns: IntArray) -> IntArray:
        """Return how far a message may be that joins each sample, by the shortest interval of samples before it."""
        if not isinstance(self.stream, IntensityStream):
            return np.full(len(shortest_ns), self.stream.window_ns)
        return np.maximum(self.stream.tolerance_ns, shortest_ns // 2)

    def decided(self, keys: IntArray) -> IntArray:
        """Return when the stream's own messages decided what joins each sample."""
        moment = np.append(self.order_of_keys, NEVER)[np.searchsorted(self.keys, keys)]
        return np.where((moment == NEVER) & (keys <= self.decided_until_ns), EARLIER, moment)

    def keep(self, first: int, joined: int) -> None:
        """Count what became of the messages, and let the stream wait with those that may still join a sample.

        Parameters
        ----------
        first : int
            Place in the queue of the first message that is kept.
        joined : int
            Number of messages before it that joined samples; not used for a held stream.
        """
        stream, losses = self.stream, self.stream.losses
        is_repeat = ~self.is_new & (self.stamps_ns == self._previous_ns)
        losses.received += len(is_repeat)
        losses.duplicate += int(is_repeat.sum())
        losses.contradicting += self._contradicting(is_repeat)
        losses.late += int((~self.is_new & ~is_repeat).sum())
        if isinstance(stream, InterpolatedStream):
            stream.past.extend(self._messages(slice(max(first - BEFORE, 0), first)))
        elif not self.is_held:
            losses.unmatched += first - joined
        stream.newest = self.newest_ns
        if len(self.values):
            stream.newest_values = self.values[-1].tolist()
        if not self.is_unstamped:
            stream.timeline.rise(self.stamps_ns[self.is_new])
        stream.awaited = stream.awaited or len(is_repeat) > 0
        stream.buffer = deque(self._messages(slice(first, None)))

    def _messages(self, part: slice) -> Iterator[Message]:
        return zip(self.keys[part].tolist(), map(tuple, self.values[part].tolist()), strict=True)

    def _contradicting(self, is_repeat: BoolArray) -> int:
        """Return how many messages (m,) that repeat a stamp have other values than the message that they repeat."""
        if not is_repeat.any():
            return 0
        values = self._came
        repeated = np.maximum.accumulate(np.where(self.is_new, np.arange(len(values)), -1))
        before = np.array(self.stream.newest_values or np.full(values.shape[1], np.nan))
        kept = np.where(repeated[:, None] >= 0, values[repeated], before)
        differs = ((values != kept) & ~(np.isnan(values) & np.isnan(kept))).any(axis=1)
        return int(np.count_nonzero(differs & is_repeat))


def _after(
    earlier: Collection[Message], stamps_ns: IntArray, order: IntArray, values: FloatArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return stamps, arrivals and values of messages after those of messages of earlier batches."""
    earlier_ns = np.array([max(key, LONG_AGO) for key, _ in earlier], dtype=np.int64)
    before = np.array([values for _, values in earlier]).reshape(len(earlier), values.shape[1])
    return (
        np.concatenate([earlier_ns, stamps_ns]),
        np.concatenate([np.full(len(earlier), EARLIER), order]),
        np.concatenate([before, values]),
    )


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
        stream = self.queue.stream
        if self.found.all() or not isinstance(stream, InterpolatedStream):
            return
        queue = self.queue
        stamps, order, values = _after(stream.past, queue.keys, queue.order_of_keys, queue.values)
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
        values = np.full((len(found), self.queue.stream.width), np.nan)
        values[found] = self.queue.values[self._index[is_sample & self.found]]
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
