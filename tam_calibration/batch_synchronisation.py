"""Joining whole batches of messages at once: the samples and losses of `Synchroniser`, for recordings.

What is usual - stamps that rise, streams that keep within the patience of each other, no message that two samples
want - is joined by searching in sorted stamps. A batch with anything else goes through message by message.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tam_calibration.message_stream import HeldStream, Stream
from tam_calibration.pointcloud_layout import CHANNEL_COLUMNS
from tam_calibration.synchronisation import Sample, Synchroniser
from tam_calibration.units import FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

_LONG_AGO, _NEVER = -(1 << 62), 1 << 62
_EARLIER = -1


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
    """

    order: IntArray
    stamps_ns: IntArray | None
    values: FloatArray

    @classmethod
    def concatenate(cls, parts: Sequence["StreamMessages"]) -> "StreamMessages":
        """Return messages that follow each other as one."""
        stamps = [part.stamps_ns for part in parts if part.stamps_ns is not None]
        return cls(
            np.concatenate([part.order for part in parts]),
            np.concatenate(stamps) if stamps else None,
            np.concatenate([part.values for part in parts]),
        )


class BatchSynchroniser(Synchroniser):
    """A synchroniser that takes many messages in a call; samples and losses are those of `push`, one by one.

    What waits between usual batches is bounded by the patience, not by the capacity.
    """

    def push_batch(self, batch: Mapping[str, StreamMessages]) -> tuple[IntArray, FloatArray]:
        """Take the next messages of the streams and return the samples that they complete.

        Parameters
        ----------
        batch : mapping
            Messages by stream: ``tam_1`` … or the channel's name; a stream without any may be absent.

        Returns
        -------
        stamps_ns : (n,) array of int
            Stamps of the samples; they go back only where `restarts` grew.
        values : (n, columns) array
            The columns of `SampleLayout` after ``time_s``.
        """
        joined = None if self._epoch else self._push_usual(batch)
        return self._push_each(batch) if joined is None else joined

    def flush_batch(self) -> tuple[IntArray, FloatArray]:
        """Return the samples that still waited for messages: there will be none."""
        return self._to_arrays(self.flush())

    def _push_each(self, batch: Mapping[str, StreamMessages]) -> tuple[IntArray, FloatArray]:
        messages: list[tuple[Any, ...]] = []
        for name, each in batch.items():
            stamps = [None] * len(each.order) if each.stamps_ns is None else each.stamps_ns.tolist()
            messages += zip(each.order.tolist(), [name] * len(stamps), stamps, each.values.tolist(), strict=True)
        messages.sort(key=lambda message: message[0])
        return self._to_arrays([sample for _, *message in messages for sample in self.push(*message)])

    def _to_arrays(self, samples: list[Sample]) -> tuple[IntArray, FloatArray]:
        width = sum(_width(stream) for stream in self._streams.values())
        values = np.array([sample.values for sample in samples]).reshape(len(samples), width)
        return np.array([sample.stamp_ns for sample in samples], dtype=np.int64), values

    def _push_usual(self, batch: Mapping[str, StreamMessages]) -> tuple[IntArray, FloatArray] | None:
        """Return the samples that a batch completes; None, with nothing changed, where it is not usual."""
        sensors = [batch[stream.name] for stream in self._sensors if stream.name in batch]
        arrivals = _Arrivals.of(sensors, max(self._newest, _LONG_AGO))
        pace, *partners = (_Queue.of(stream, batch.get(stream.name), arrivals) for stream in self._streams.values())
        if any(self._is_unusual(queue, arrivals) for queue in (pace, *partners)):
            return None
        before = self._newest, self._horizon, self._hold_horizon, self._epoch_start
        for stamp_ns in arrivals.newest_ns[[0, -1]].tolist() if len(arrivals.order) else []:
            if stamp_ns > self._newest:
                self._advance(stamp_ns)
        keys = pace.keys[: np.searchsorted(pace.keys, self._limit(partners), "right")]
        matches = [queue.match(keys) for queue in partners]
        is_sample = np.logical_and.reduce([match.found for match in matches[: len(self._sensors) - 1]], axis=0)
        is_sample = np.broadcast_to(is_sample, keys.shape)
        if any(match.wanted_twice(is_sample) for match in matches):
            self._newest, self._horizon, self._hold_horizon, self._epoch_start = before
            return None
        matches = self._without_what_came_later(keys, pace, partners, matches, arrivals)
        values = [pace.values[: len(keys)][is_sample], *(match.values(is_sample) for match in matches)]
        self._account(keys, is_sample, pace, matches)
        tail, tail_values = self._to_arrays(self._complete())
        return np.concatenate([keys[is_sample], tail]), np.concatenate([np.hstack(values), tail_values])

    def _is_unusual(self, queue: "_Queue", arrivals: "_Arrivals") -> bool:
        """Return whether a stream's messages step back, lag too far, or come from a channel not awaited so far."""
        new = queue.stamps_ns
        if not len(new) or queue.is_unstamped:
            return bool(len(new)) and not queue.stream.awaited
        patience = self._hold_patience_ns if queue.is_held else self._patience_ns - queue.stream.window_ns
        steps_back = (new < 0) | (new <= queue.previous_ns - self._patience_ns)
        lags = queue.is_new & (arrivals.newest_before(queue.order) >= new + patience)
        return not queue.stream.awaited or bool((steps_back | lags).any())

    def _limit(self, partners: Sequence["_Queue"]) -> int:
        """Return the last stamp at which it is decided what joins a sample."""
        limits = [
            max(queue.decided_until_ns, self._hold_horizon if queue.is_held else self._horizon)
            for queue in partners
            if queue.stream.awaited
        ]
        return max(min(limits, default=_NEVER), _LONG_AGO)

    def _without_what_came_later(
        self,
        keys: IntArray,
        pace: "_Queue",
        partners: Sequence["_Queue"],
        matches: Sequence["_Match"],
        arrivals: "_Arrivals",
    ) -> list["_Match"]:
        """Return the matches without messages that have no stamp and arrived after their sample was complete."""
        if not any(queue.is_unstamped for queue in partners):
            return list(matches)
        start = np.maximum(keys, max(self._epoch_start, _LONG_AGO))
        decided = [pace.order_of_keys[: len(keys)]]
        for queue in partners:
            patience = self._hold_patience_ns if queue.is_held else self._patience_ns
            own = queue.decided(keys) if queue.stream.awaited else np.full(len(keys), _EARLIER)
            decided.append(np.minimum(own, arrivals.reach(start + patience)))
        # A sample that lacks a sensor is given up as soon as that is known.
        lacks = np.array([~match.found for match in matches[: len(self._sensors) - 1]] + [np.ones(len(keys), bool)])
        last = np.where(lacks[:-1].any(axis=0), lacks.argmax(axis=0) + 1, len(partners))
        complete = np.maximum.accumulate(decided)[last, np.arange(len(keys))]
        complete = np.maximum.accumulate(complete)
        return [
            match.arrived_until(keys, complete) if queue.is_unstamped else match
            for queue, match in zip(partners, matches, strict=True)
        ]

    def _account(self, keys: IntArray, is_sample: BoolArray, pace: "_Queue", matches: Sequence["_Match"]) -> None:
        """Count what was lost, and let the streams keep what may still join a sample."""
        lacking = ~is_sample
        for match in matches:
            is_sensor = match.queue.stream in self._sensors
            missing = ~match.found & (lacking if is_sensor else is_sample)
            match.queue.stream.losses.missing += int(missing.sum())
            if is_sensor:
                lacking = lacking & match.found
            match.queue.keep(*match.used(keys, is_sample))
        pace.keep(len(keys), int(is_sample.sum()))
        for match in matches:
            if len(match.queue.stamps_ns) and not self._sensors[0].buffer:
                match.queue.stream.forget(self._horizon)
        if is_sample.any():
            self.delivered += int(is_sample.sum())
            self._last_delivered = int(keys[is_sample][-1])


@dataclass(frozen=True, eq=False)
class _Arrivals:
    """When the sensors' messages of a batch arrived, and the newest stamp of any sensor then."""

    order: IntArray
    newest_ns: IntArray
    newest_of_earlier_ns: int

    @classmethod
    def of(cls, sensors: Sequence[StreamMessages], newest_ns: int) -> "_Arrivals":
        none = np.zeros(0, dtype=np.int64)
        order = np.concatenate([none, *(each.order for each in sensors)])
        stamps = np.concatenate([none, *(each.stamps_ns for each in sensors if each.stamps_ns is not None)])
        in_order = np.argsort(order, kind="stable")
        return cls(order[in_order], np.maximum(np.maximum.accumulate(stamps[in_order]), newest_ns), newest_ns)

    def newest_before(self, order: IntArray) -> IntArray:
        """Return the newest stamp of any sensor before each moment."""
        return np.concatenate([[self.newest_of_earlier_ns], self.newest_ns])[np.searchsorted(self.order, order)]

    def reach(self, stamps_ns: IntArray) -> IntArray:
        """Return when the sensors reached each stamp."""
        moment = np.append(self.order, _NEVER)[np.searchsorted(self.newest_ns, stamps_ns)]
        return np.where(stamps_ns <= self.newest_of_earlier_ns, _EARLIER, moment)


@dataclass(frozen=True, eq=False)
class _Queue:
    """The messages of a stream: what came, and what of it and of the messages before may join a sample."""

    stream: Stream
    stamps_ns: IntArray
    order: IntArray
    is_unstamped: bool
    previous_ns: IntArray
    is_new: BoolArray
    keys: IntArray
    order_of_keys: IntArray
    values: FloatArray

    @classmethod
    def of(cls, stream: Stream, messages: StreamMessages | None, arrivals: _Arrivals) -> "_Queue":
        none, width = np.zeros(0, dtype=np.int64), _width(stream)
        if messages is None:
            messages = StreamMessages(none, none, np.zeros((0, width)))
        is_unstamped = messages.stamps_ns is None
        stamps = arrivals.newest_before(messages.order) if messages.stamps_ns is None else messages.stamps_ns
        newest = max(stream.newest, _LONG_AGO)
        previous = np.maximum.accumulate(np.concatenate([[newest], stamps]))[:-1]
        is_new = stamps > previous if not is_unstamped else np.ones(len(stamps), dtype=bool)
        new = slice(None) if is_new.all() else is_new
        waiting = np.array([max(key, _LONG_AGO) for key, _ in stream.buffer], dtype=np.int64)
        values = np.array([values for _, values in stream.buffer]).reshape(len(waiting), width)
        return cls(
            stream,
            stamps,
            messages.order,
            is_unstamped,
            previous,
            is_new,
            np.concatenate([waiting, stamps[new]]),
            np.concatenate([np.full(len(waiting), _EARLIER), messages.order[new]]),
            np.concatenate([values, messages.values[new]]),
        )

    @property
    def is_held(self) -> bool:
        """Whether a message holds until the next."""
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

    def match(self, keys: IntArray) -> "_Match":
        """Return which message joins each sample."""
        if not len(self.keys):
            return _Match(self, np.zeros(len(keys), dtype=np.int64), np.zeros(len(keys), dtype=bool))
        if self.is_held:
            return self.match_held(keys, np.searchsorted(self.keys, keys, "right") - 1)
        after = np.minimum(np.searchsorted(self.keys, keys), len(self.keys) - 1)
        before = np.maximum(after - 1, 0)
        index = np.where(keys - self.keys[before] <= np.abs(self.keys[after] - keys), before, after)
        return _Match(self, index, np.abs(self.keys[index] - keys) <= self.stream.window_ns)

    def match_held(self, keys: IntArray, index: IntArray) -> "_Match":
        """Return the match of held messages, -1 for none, as far as they are not too old."""
        found = (index >= 0) & (keys - self.keys[index] <= self.stream.window_ns)
        return _Match(self, np.maximum(index, 0), found)

    def decided(self, keys: IntArray) -> IntArray:
        """Return when the stream's own messages decided what joins each sample."""
        moment = np.append(self.order_of_keys, _NEVER)[np.searchsorted(self.keys, keys)]
        return np.where((moment == _NEVER) & (keys <= self.decided_until_ns), _EARLIER, moment)

    def keep(self, first: int, joined: int) -> None:
        """Count what became of the messages, and let the stream wait with those from the first on."""
        stream, losses, count = self.stream, self.stream.losses, len(self.stamps_ns)
        repeats = int((~self.is_new & (self.stamps_ns == self.previous_ns)).sum())
        losses.received += count
        losses.duplicate += repeats
        losses.late += count - int(self.is_new.sum()) - repeats
        losses.unmatched += 0 if self.is_held else first - joined
        stream.newest = self.newest_ns
        stream.awaited = stream.awaited or count > 0
        keys = self.keys[first:]
        is_last = np.append(keys[1:] != keys[:-1], True)[: len(keys)]
        values = map(tuple, self.values[first:][is_last].tolist())
        stream.buffer = deque(zip(keys[is_last].tolist(), values, strict=True))


@dataclass(frozen=True, eq=False)
class _Match:
    """Which message of a stream joins each sample, and whether one does."""

    queue: _Queue
    index: IntArray
    found: BoolArray

    def wanted_twice(self, is_sample: BoolArray) -> bool:
        """Whether a message joins a sample that a later one wants too."""
        index, joins = self.index[self.found], is_sample[self.found]
        return not self.queue.is_held and bool((joins[:-1] & (index[1:] == index[:-1])).any())

    def arrived_until(self, keys: IntArray, order: IntArray) -> "_Match":
        """Return the match of held messages among those that arrived until a moment of each sample."""
        latest = np.searchsorted(self.queue.order_of_keys, order, "right") - 1
        return self.queue.match_held(keys, np.minimum(np.where(self.found, self.index, -1), latest))

    def values(self, is_sample: BoolArray) -> FloatArray:
        """Return the values that join the samples; NaN where there are none."""
        found = self.found[is_sample]
        if not found.any():
            return np.full((len(found), self.queue.values.shape[1]), np.nan)
        values: FloatArray = self.queue.values[self.index[is_sample]]
        if not found.all():
            values[~found] = np.nan
        return values

    def used(self, keys: IntArray, is_sample: BoolArray) -> tuple[int, int]:
        """Return the first message that may join a later sample, and how many joined these."""
        if not len(keys):
            return 0, 0
        if self.queue.is_held:
            return max(int(np.searchsorted(self.queue.keys, keys[-1], "right")) - 1, 0), 0
        joined = self.index[self.found & is_sample]
        too_old = int(np.searchsorted(self.queue.keys, keys[-1] - self.queue.stream.window_ns))
        return max(too_old, int(joined[-1]) + 1 if len(joined) else 0), len(joined)


def _width(stream: Stream) -> int:
    return len(CHANNEL_COLUMNS.get(stream.name, "xyz"))
