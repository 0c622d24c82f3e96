"""The messages of a batch, stream by stream, and which of them join which samples: searches in sorted stamps."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.interpolation import BEFORE, interpolated
from tam_calibration.messages.point_cloud import columns_of, is_channel
from tam_calibration.messages.stream import HeldStream, IntensityStream, InterpolatedStream, OnceStream, Stream
from tam_calibration.messages.timeline import STEP_NS
from tam_calibration.model.mounting import Turn
from tam_calibration.model.units import FloatArray, IntArray

BoolArray = NDArray[np.bool_]

LONG_AGO, NEVER = -(1 << 62), 1 << 62
"""Stamps, or moments, before and after all others."""

EARLIER = -1
"""The moment of arrival of what came before a batch."""


@dataclass(frozen=True, eq=False)
class StreamMessages:
    """Messages of one stream.

    Parameters
    ----------
    order : (n,) array of int
        When each arrived among the batch's messages of all streams, increasing from 0.
    stamps_ns : (n,) array of int, optional
        Their stamps; None for a held channel without stamps.
    values : (n, width) array
        The values of the stream's columns.
    arrived_ns : (n,) array of int, optional
        When they arrived, by the clock of the recorder.
    """

    order: IntArray
    stamps_ns: IntArray | None
    values: FloatArray
    arrived_ns: IntArray | None = None

    @property
    def arrivals_ns(self) -> IntArray:
        """When each arrived, (n,); zeros where that is not known."""
        return np.zeros_like(self.order) if self.arrived_ns is None else self.arrived_ns

    def earlier(self, delay_ns: int) -> "StreamMessages":
        """Return the messages with stamps that are set back by a delay."""
        return self if self.stamps_ns is None else replace(self, stamps_ns=self.stamps_ns - delay_ns)

    def take(self, index: BoolArray) -> "StreamMessages":
        """Return the messages that a mask (n,) selects."""
        stamps_ns = None if self.stamps_ns is None else self.stamps_ns[index]
        return StreamMessages(self.order[index], stamps_ns, self.values[index], self.arrivals_ns[index])

    def turned(self, turn: Turn) -> "StreamMessages":
        """Return the messages with values that are turned."""
        return replace(self, values=np.column_stack(turn(*self.values.T)))

    @classmethod
    def concatenate(cls, parts: Sequence["StreamMessages"]) -> "StreamMessages":
        """Return messages that follow each other as one."""
        stamps = [part.stamps_ns for part in parts if part.stamps_ns is not None]
        return cls(
            np.concatenate([part.order for part in parts]),
            np.concatenate(stamps) if stamps else None,
            np.concatenate([part.values for part in parts]),
            np.concatenate([part.arrivals_ns for part in parts]),
        )


@dataclass(frozen=True, eq=False)
class Arrivals:
    """When the sensors' messages of a batch arrived, in order and in time, and the newest stamp of any sensor then."""

    order: IntArray
    newest_ns: IntArray
    newest_of_earlier_ns: int
    arrived_ns: IntArray

    @classmethod
    def of(cls, sensors: Sequence[StreamMessages], newest_ns: int) -> "Arrivals":
        """Return the arrivals of a batch.

        Parameters
        ----------
        sensors : sequence of StreamMessages
            What came of each sensor in the batch; none of a sensor that was silent.
        newest_ns : int
            Newest stamp of any sensor before the batch, nanoseconds; ``LONG_AGO`` before the first.
        """
        none = np.zeros(0, dtype=np.int64)
        order = np.concatenate([none, *(each.order for each in sensors)])
        stamps = np.concatenate([none, *(each.stamps_ns for each in sensors if each.stamps_ns is not None)])
        in_order = np.argsort(order, kind="stable")
        newest = np.maximum(np.maximum.accumulate(stamps[in_order]), newest_ns)
        arrived = np.concatenate([none, *(each.arrivals_ns for each in sensors)])
        return cls(order[in_order], newest, newest_ns, arrived[in_order])

    def rises(self) -> tuple[IntArray, IntArray]:
        """Return the stamps (n,) that are newer than all before, and when they arrived."""
        rises = np.diff(self.newest_ns, prepend=self.newest_of_earlier_ns) > 0
        return self.newest_ns[rises], self.arrived_ns[rises]

    def newest_before(self, order: IntArray) -> IntArray:
        """Return the newest stamp of any sensor before each moment."""
        return np.concatenate([[self.newest_of_earlier_ns], self.newest_ns])[np.searchsorted(self.order, order)]

    def reach(self, stamps_ns: IntArray) -> IntArray:
        """Return when the sensors reached each stamp."""
        moment = np.append(self.order, NEVER)[np.searchsorted(self.newest_ns, stamps_ns)]
        return np.where(stamps_ns <= self.newest_of_earlier_ns, EARLIER, moment)


@dataclass(frozen=True, eq=False)
class Queue:
    """The messages of a stream: what came, and what of it and of the messages before may join a sample.

    Parameters
    ----------
    stream : Stream
        Where they wait from one batch to the next.
    stamps_ns, order : (m,) array of int
        Stamps of what came, for messages without stamps those that they take, and when it came.
    is_unstamped : bool
        Whether what came has no stamps.
    previous_ns : (m,) array of int
        The newest stamp of the stream before each.
    is_new : (m,) array of bool
        Whether each is neither repeated nor late.
    keys, order_of_keys : (n,) array of int
        Stamps of what may join, rising, and when it came.
    values : (n, width) array
        Its values.
    contradicting : int
        Messages that repeat the stamp before with other values.
    """

    stream: Stream
    stamps_ns: IntArray
    order: IntArray
    is_unstamped: bool
    previous_ns: IntArray
    is_new: BoolArray
    keys: IntArray
    order_of_keys: IntArray
    values: FloatArray
    contradicting: int

    @classmethod
    def of(cls, stream: Stream, messages: StreamMessages | None, arrivals: Arrivals) -> "Queue":
        """Return the queue of a stream with what came of it.

        Parameters
        ----------
        stream : Stream
            Its buffer contains what waits from earlier batches.
        messages : StreamMessages or None
            What came of it in this batch; None where nothing did.
        arrivals : Arrivals
            Of the sensors in this batch; a message without a stamp takes the sensors' newest stamp at its arrival.
        """
        none, width = np.zeros(0, dtype=np.int64), width_of(stream)
        if messages is None:
            messages = StreamMessages(none, none, np.zeros((0, width)))
        is_unstamped = messages.stamps_ns is None
        stamps = arrivals.newest_before(messages.order) if messages.stamps_ns is None else messages.stamps_ns
        newest = max(stream.newest, LONG_AGO)
        previous = np.maximum.accumulate(np.concatenate([[newest], stamps]))[:-1]
        is_new = stamps > previous if not is_unstamped else np.ones(len(stamps), dtype=bool)
        new = slice(None) if is_new.all() else is_new
        waiting = np.array([max(key, LONG_AGO) for key, _ in stream.buffer], dtype=np.int64)
        values = np.array([values for _, values in stream.buffer]).reshape(len(waiting), width)
        return cls(
            stream,
            stamps,
            messages.order,
            is_unstamped,
            previous,
            is_new,
            np.concatenate([waiting, stamps[new]]),
            np.concatenate([np.full(len(waiting), EARLIER), messages.order[new]]),
            np.concatenate([values, messages.values[new]]),
            0 if is_new.all() else _contradicting(stream, messages.values, is_new, stamps == previous),
        )

    def jumps(self, arrivals: Arrivals) -> bool:
        """Whether a stamp jumps that the sensors do not make credible, or one before it is doubtful."""
        timeline, new = self.stream.timeline, self.stamps_ns[self.is_new]
        if self.is_unstamped or not len(self.stamps_ns):
            return False
        is_back = self.stamps_ns <= self.previous_ns - STEP_NS
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

    def match(self, keys: IntArray, shortest_ns: IntArray) -> "Match":
        """Return which message joins each sample."""
        if not len(self.keys):
            return Match(self, np.zeros(len(keys), dtype=np.int64), np.zeros(len(keys), dtype=bool))
        if self.is_held:
            return self.match_held(keys, np.searchsorted(self.keys, keys, "right") - 1)
        if np.array_equal(self.keys[: len(keys)], keys):
            return Match(self, np.arange(len(keys)), np.ones(len(keys), dtype=bool))
        after = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        before = np.maximum(after - 1, 0)
        index = np.where(keys - self.keys[before] <= np.abs(self.keys[after] - keys), before, after)
        return Match(self, index, np.abs(self.keys[index] - keys) <= self.windows_ns(shortest_ns))

    def match_held(self, keys: IntArray, index: IntArray) -> "Match":
        """Return the match of held messages, as far as they are not too old.

        Parameters
        ----------
        keys : (n,) array of int
            Stamps of the samples, nanoseconds.
        index : (n,) array of int
            Place in the queue of the message for each sample; -1 for none.
        """
        found = (index >= 0) & (keys - self.keys[index] <= self.stream.window_ns)
        return Match(self, np.maximum(index, 0), found)

    def decided(self, keys: IntArray) -> IntArray:
        """Return when the stream's own messages decided what joins each sample."""
        moment = np.append(self.order_of_keys, NEVER)[np.searchsorted(self.keys, keys)]
        return np.where((moment == NEVER) & (keys <= self.decided_until_ns), EARLIER, moment)

    def with_past(self) -> tuple[IntArray, IntArray, FloatArray]:
        """Return stamps, arrivals and values of what may join, after those of the last messages that no longer may."""
        past = self.stream.past if isinstance(self.stream, InterpolatedStream) else ()
        if not past:
            return self.keys, self.order_of_keys, self.values
        stamps = np.array([max(key, LONG_AGO) for key, _ in past], dtype=np.int64)
        return (
            np.concatenate([stamps, self.keys]),
            np.concatenate([np.full(len(past), EARLIER), self.order_of_keys]),
            np.concatenate([[values for _, values in past], self.values]),
        )

    def keep(self, first: int, joined: int) -> None:
        """Count what became of the messages, and let the stream wait with those that may still join a sample.

        Parameters
        ----------
        first : int
            Place in the queue of the first message that is kept.
        joined : int
            Number of messages before it that joined samples; not used for a held stream.
        """
        stream, losses, count = self.stream, self.stream.losses, len(self.stamps_ns)
        repeats = int((~self.is_new & (self.stamps_ns == self.previous_ns)).sum())
        losses.received += count
        losses.duplicate += repeats
        losses.contradicting += self.contradicting
        losses.late += count - int(self.is_new.sum()) - repeats
        if isinstance(stream, InterpolatedStream):
            past = zip(
                self.keys[:first][-BEFORE:].tolist(), map(tuple, self.values[:first][-BEFORE:].tolist()), strict=True
            )
            stream.past.extend(past)
        elif not self.is_held:
            losses.unmatched += first - joined
        stream.newest = self.newest_ns
        if len(self.values):
            stream.newest_values = self.values[-1].tolist()
        if not self.is_unstamped:
            stream.timeline.rise(self.stamps_ns[self.is_new])
        stream.awaited = stream.awaited or count > 0
        stream.buffer = deque(zip(self.keys[first:].tolist(), map(tuple, self.values[first:].tolist()), strict=True))


def _contradicting(stream: Stream, values: FloatArray, is_new: BoolArray, is_repeat: BoolArray) -> int:
    """Return how many messages (m, width) that repeat a stamp have other values than the message that they repeat."""
    repeated = np.maximum.accumulate(np.where(is_new, np.arange(len(values)), -1))
    before = np.array(stream.newest_values or np.full(values.shape[1], np.nan))
    kept = np.where(repeated[:, None] >= 0, values[repeated], before)
    differs = ((values != kept) & ~(np.isnan(values) & np.isnan(kept))).any(axis=1)
    return int(np.count_nonzero(differs & is_repeat & ~is_new))


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
        return self.queue.match_held(keys, np.minimum(np.where(self.found, self.index, -1), latest))

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


def width_of(stream: Stream) -> int:
    """Return the number of columns of a stream."""
    return len(columns_of(stream.name)) if is_channel(stream.name) else 3
