"""Which messages of a queue join which samples of a batch, or what the messages around a sample interpolate to."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.interpolation import interpolated
from tam_calibration.messages.batch_queue import EARLIER, Queue
from tam_calibration.messages.samples import BoolArray
from tam_calibration.messages.stream import HeldStream, InterpolatedStream, OnceStream
from tam_calibration.model.units import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Match:
    """Which message of a stream joins each sample, and whether one does, or else what those around it tell.

    A message that joins one may have been the next one's: that is doubtful until the next message of sensor 1.
    """

    queue: Queue
    index: IntArray
    found: BoolArray
    is_doubtful: BoolArray | None = None
    between: "Between | None" = None

    @classmethod
    def of(cls, queue: Queue, keys: IntArray, shortest_ns: IntArray) -> "Match":
        """Return which message of a queue joins each sample.

        Parameters
        ----------
        queue : Queue
            The messages.
        keys : (n,) array of int
            Stamps of the samples, rising, nanoseconds.
        shortest_ns : (n,) array of int
            The shortest interval of samples before each, nanoseconds; 0 where it is not known.
        """
        if not len(queue.keys):
            return cls(queue, np.zeros(len(keys), dtype=np.int64), np.zeros(len(keys), dtype=bool))
        if queue.is_held:
            return cls.of_held(queue, keys, np.searchsorted(queue.keys, keys, "right") - 1)
        if np.array_equal(queue.keys[: len(keys)], keys):
            return cls(queue, np.arange(len(keys)), np.ones(len(keys), dtype=bool))
        after = np.minimum(np.searchsorted(queue.keys, keys), len(queue.keys) - 1)
        before = np.maximum(after - 1, 0)
        index = np.where(keys - queue.keys[before] <= np.abs(queue.keys[after] - keys), before, after)
        return cls(queue, index, np.abs(queue.keys[index] - keys) <= queue.windows_ns(shortest_ns))

    @classmethod
    def of_held(cls, queue: Queue, keys: IntArray, index: IntArray) -> "Match":
        """Return the match of held messages that are not too old.

        Parameters
        ----------
        queue : Queue
            The messages.
        keys : (n,) array of int
            Stamps of the samples, nanoseconds.
        index : (n,) array of int
            Place in the queue of the message for each sample; -1 for none.
        """
        found = (index >= 0) & (keys - queue.keys[index] <= queue.stream.window_ns)
        return cls(queue, np.maximum(index, 0), found)

    @property
    def has_value(self) -> BoolArray:
        """(n,) whether each sample has a value of the stream."""
        return self.found if self.between is None else self.found | self.between.found

    def interpolated(self, keys: IntArray) -> "Match":
        """Return the match with what the messages around the other samples tell of a sensor."""
        if self.found.all() or not isinstance(self.queue.stream, InterpolatedStream):
            return self
        return replace(self, between=Between.of(self.queue, keys, ~self.found))

    def wanted_twice(self, is_sample: BoolArray) -> bool:
        """Whether a message joins a sample that a later one wants too."""
        index, joins = self.index[self.found], is_sample[self.found]
        return not self.queue.is_held and bool((joins[:-1] & (index[1:] == index[:-1])).any())

    def is_late(self, moments: IntArray) -> bool:
        """Whether a message after a sample came later than at the sample's moment."""
        return self.between is not None and bool((self.between.arrival > moments[~self.found]).any())

    def arrived_until(self, keys: IntArray, order: IntArray) -> "Match":
        """Return the match of held messages among those that had arrived in time.

        Parameters
        ----------
        keys : (n,) array of int
            Stamps of the samples, nanoseconds.
        order : (n,) array of int
            When each sample was complete, among the arrivals of the batch.
        """
        latest = np.searchsorted(self.queue.order_of_keys, order, "right") - 1
        return Match.of_held(self.queue, keys, np.minimum(np.where(self.found, self.index, -1), latest))

    def once(self, keys: IntArray, is_sample: BoolArray) -> "Match":
        """Return the match of messages without stamps that join one sample each, as an `OnceStream` lets them.

        Parameters
        ----------
        keys : (n,) array of int
            Stamps of the samples, nanoseconds.
        is_sample : (n,) array of bool
            Which of them become samples.
        """
        if not isinstance(self.queue.stream, OnceStream):
            return self
        newest = np.maximum.accumulate(np.where(self.found, self.index, -1)[is_sample])
        before = np.concatenate([[-1], newest[:-1]])[: len(newest)]
        oldest = np.searchsorted(self.queue.keys, keys[is_sample] - self.queue.stream.window_ns)
        count = np.maximum(newest + 1 - np.maximum(oldest, before + 1), 0)
        # One message waits on after a sample to which two came, until one comes to which none does.
        is_fresh = oldest <= before
        decisive = np.maximum.accumulate(np.where((count != 1) | ~is_fresh, np.arange(len(count)), 0))
        waits_on = (count >= 2)[decisive]
        count += np.concatenate([[False], waits_on[:-1]])[: len(count)] & is_fresh
        index, found = np.zeros_like(self.index), np.zeros_like(self.found)
        index[is_sample], found[is_sample] = np.maximum(newest - (count >= 2), 0), count >= 1
        return replace(self, index=index, found=found)

    def values(self, is_sample: BoolArray) -> FloatArray:
        """Return the values that join the samples; NaN where there are none."""
        found = self.found[is_sample]
        if not len(self.queue.values):
            values = np.full((len(found), self.queue.values.shape[1]), np.nan)
        else:
            values = self.queue.values[self.index[is_sample]]
            values[~found] = np.nan
        if self.between is not None:
            values[~found] = self.between.values[is_sample[~self.found]]
        return values

    def used(self, keys: IntArray, is_sample: BoolArray, shortest_ns: IntArray) -> tuple[int, int]:
        """Return the first message that may join a later sample, and how many joined these.

        Parameters
        ----------
        keys : (n,) array of int
            Stamps of sensor 1 that were decided in this batch, rising, nanoseconds.
        is_sample : (n,) array of bool
            Which of them became samples.
        shortest_ns : (n,) array of int
            The shortest interval of samples before each, nanoseconds; 0 where it is not known.
        """
        if not len(keys):
            return 0, 0
        stream, joined = self.queue.stream, self.index[self.found & is_sample]
        if isinstance(stream, HeldStream):
            too_old = int(np.searchsorted(self.queue.keys, keys[-1], "right")) - stream.kept
            joined = joined if isinstance(stream, OnceStream) else joined[:0]
        else:
            too_old = int(np.searchsorted(self.queue.keys, keys[-1] - self.queue.windows_ns(shortest_ns)[-1]))
        return max(too_old, 0, int(joined[-1]) + 1 if len(joined) else 0), len(joined)


@dataclass(frozen=True, eq=False)
class Between:
    """What the messages of a sensor tell of samples that no message joins as it is.

    Parameters
    ----------
    found : (n,) array of bool
        The samples of which they tell.
    values : (m, 3) array
        The values at the m samples that were asked for; NaN where they tell none.
    arrival : (m,) array of int
        When the message after each of these came.
    after : (t,) array of int
        Place of that message, where they tell a value.
    weight : (t, 5) array
        Of the messages that make it.
    """

    found: BoolArray
    values: FloatArray
    arrival: IntArray
    after: IntArray
    weight: FloatArray

    @classmethod
    def of(cls, queue: Queue, keys: IntArray, asked: BoolArray) -> "Between":
        """Return what the messages of a queue tell of some of the samples."""
        stamps, order, values = queue.with_past()
        between, after, weight = interpolated(stamps, values, keys[asked])
        found = asked.copy()
        found[asked] = after < len(stamps)
        arrival = np.append(order, EARLIER)[after]
        return cls(found, between, arrival, after[after < len(stamps)], weight)
