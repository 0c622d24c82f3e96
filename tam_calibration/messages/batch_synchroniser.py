"""Joining complete batches of messages at once: the samples and losses of `Synchroniser`, for recordings.

What is usual - stamps that rise, streams that keep within the patience of each other, no silent sensor, no message that
two samples want - is joined by searching in sorted stamps. A batch with anything else goes through message by message.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from tam_calibration.messages.batch_queue import EARLIER, LONG_AGO, Arrivals, Match, Queue
from tam_calibration.messages.samples import BoolArray, StreamMessages, in_order
from tam_calibration.messages.stream import BEFORE_ALL
from tam_calibration.messages.synchroniser import REMEMBERED, Sample, Synchroniser
from tam_calibration.messages.timeline import NEVER
from tam_calibration.model.units import FloatArray, IntArray


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
        before = self._newest, self._horizon, self._hold_horizon, self._epoch_start
        if not self._epoch:
            delays = self._delays_ns
            joined = self._push_usual({name: each.earlier(delays.get(name, 0)) for name, each in batch.items()})
            if joined is not None:
                return joined
        self._newest, self._horizon, self._hold_horizon, self._epoch_start = before
        return self._push_each(batch)

    def flush_batch(self) -> tuple[IntArray, FloatArray]:
        """Return the samples that still waited for messages: there will be none."""
        return self._to_arrays(self.flush())

    def _push_each(self, batch: Mapping[str, StreamMessages]) -> tuple[IntArray, FloatArray]:
        return self._to_arrays([sample for message in in_order(batch) for sample in self.push(*message)])

    def _to_arrays(self, samples: list[Sample]) -> tuple[IntArray, FloatArray]:
        width = sum(stream.width for stream in self._streams.values())
        values = np.array([sample.values for sample in samples]).reshape(len(samples), width)
        return np.array([sample.stamp_ns for sample in samples], dtype=np.int64), values

    def _push_usual(self, batch: Mapping[str, StreamMessages]) -> tuple[IntArray, FloatArray] | None:
        """Return the samples that a batch completes; None, with nothing changed but time, where it is not usual."""
        sensors = [batch[stream.name] for stream in self._sensors if stream.name in batch]
        arrivals = Arrivals(sensors, max(self._newest, LONG_AGO))
        pace, *partners = (Queue(stream, batch.get(stream.name), arrivals) for stream in self._streams.values())
        if any(self._is_unusual(queue, arrivals) for queue in (pace, *partners)) or self._has_stall(arrivals):
            return None
        sensor_queues = [pace, *partners[: len(self._sensors) - 1]]
        if self._has_silence(sensor_queues, arrivals) or (pace.keys[:1] <= max(self._previous, LONG_AGO)).any():
            return None
        self._now_ns = int(np.append(self._newest_at_ns, arrivals.rises()[1])[-1])
        for stamp_ns in arrivals.newest_ns[[0, -1]].tolist() if len(arrivals.newest_ns) else []:
            if stamp_ns > self._newest:
                self._advance(stamp_ns)
        keys = pace.keys[: np.searchsorted(pace.keys, self._limit(partners), "right")]
        shortest = self._shortest_intervals(keys)
        matches = [Match(queue, keys, shortest) for queue in partners]
        following = np.append(pace.keys[1:], NEVER)[: len(keys)]
        if not all(match.leave_to_next(following, shortest) for match in matches):
            return None
        for match in matches:
            match.interpolate()
        is_sample = np.logical_and.reduce([match.has_value for match in matches[: len(self._sensors) - 1]], axis=0)
        is_sample = np.broadcast_to(is_sample, keys.shape)
        overdue = arrivals.reach(np.maximum(keys, max(self._epoch_start, LONG_AGO)) + self._patience_ns)
        if any(match.wanted_twice(is_sample) or match.is_late(overdue) for match in matches):
            return None
        self._newest_at_ns = self._now_ns
        if any(queue.is_unstamped for queue in partners):
            self._leave_what_came_later(keys, pace, matches, arrivals)
        for match in matches:
            match.join_once(is_sample)
        values = [pace.values[: len(keys)][is_sample], *(match.values(is_sample) for match in matches)]
        self._account(keys, is_sample, pace, matches)
        if len(keys):
            self._intervals.extend(np.diff(keys, prepend=max(self._previous, LONG_AGO)).tolist())
            self._previous = int(keys[-1])
            self._silence.hear_first(self._previous)
        tail, tail_values = self._to_arrays(self._complete())
        return np.concatenate([keys[is_sample], tail]), np.concatenate([np.hstack(values), tail_values])

    def _is_unusual(self, queue: Queue, arrivals: Arrivals) -> bool:
        """Return whether a stream's messages step back, lag too far, or come from a channel not awaited so far."""
        new = queue.stamps_ns
        if not len(new) or queue.is_unstamped:
            return bool(len(new)) and not queue.stream.awaited
        patience = self._hold_patience_ns if queue.is_held else self._patience_ns - queue.stream.window_ns
        lags = queue.is_new & (arrivals.newest_before(queue.order) >= new + patience)
        return not queue.stream.awaited or queue.jumps(arrivals) or bool((lags | (new < 0)).any())

    def _has_stall(self, arrivals: Arrivals) -> bool:
        """Return whether streams catch up after a stall in a batch, or when it begins."""
        stamps_ns, arrived_ns = arrivals.rises()
        if not len(stamps_ns):
            return self._caught_up_ns > 0
        before = max(self._newest, LONG_AGO)
        late = np.diff(arrived_ns, prepend=self._newest_at_ns) - np.diff(stamps_ns, prepend=before)
        return self._is_catching_up(int(arrived_ns[0])) or bool((late > self._patience_ns).any())

    def _has_silence(self, sensors: Sequence[Queue], arrivals: Arrivals) -> bool:
        """Return whether a sensor is silent at some time in a batch, or in what waits from before."""
        if self._newest == BEFORE_ALL and len(arrivals.newest_ns):
            self._silence.begin(int(arrivals.newest_ns[0]))
        limit_ns = self._silence.limit_ns
        horizon = int(arrivals.newest_ns[-1]) - self._patience_ns if len(arrivals.newest_ns) else self._horizon
        for queue in sensors:
            last = max(self._silence.last(queue.stream), LONG_AGO)
            gaps = np.diff(np.append(queue.keys, max(horizon, queue.newest_ns)), prepend=last)
            if (gaps > limit_ns).any():
                return True
        return False

    def _limit(self, partners: Sequence[Queue]) -> int:
        """Return the last stamp at which it is decided what joins a sample."""
        awaited = [queue for queue in partners if queue.stream.awaited]
        horizons = (self._horizon, self._hold_horizon)
        limits = [max(queue.decided_until_ns, horizons[queue.is_held]) for queue in awaited]
        return max(min(limits, default=NEVER), LONG_AGO)

    def _shortest_intervals(self, keys: IntArray) -> IntArray:
        """Return the shortest of the intervals that are remembered at each sample; 0 where they are too few."""
        if not len(keys):
            return keys
        earlier = [min(interval, NEVER) for interval in self._intervals]
        intervals = np.diff(keys, prepend=max(self._previous, LONG_AGO))
        padded = np.concatenate([np.zeros(REMEMBERED - len(earlier)), earlier, intervals]).astype(np.int64)
        shortest: IntArray = sliding_window_view(padded, REMEMBERED + 1).min(axis=1)
        return shortest

    def _leave_what_came_later(self, keys: IntArray, pace: Queue, matches: Sequence[Match], arrivals: Arrivals) -> None:
        """Leave messages to later samples that have no stamp and arrived after their sample was complete."""
        start = np.maximum(keys, max(self._epoch_start, LONG_AGO))
        decided = [pace.order_of_keys[: len(keys)]]
        following = np.append(pace.order_of_keys[1:], NEVER)[: len(keys)]
        for match in matches:
            queue = match.queue
            patience = self._hold_patience_ns if queue.is_held else self._patience_ns
            own = queue.decided(keys) if queue.stream.awaited else np.full(len(keys), EARLIER)
            own = np.where(match.is_doubtful, np.maximum(own, following), own)
            decided.append(np.minimum(own, arrivals.reach(start + patience)))
        # A sample that lacks a sensor is given up as soon as that is known.
        lacks = np.array([~match.has_value for match in matches[: len(self._sensors) - 1]] + [np.ones(len(keys), bool)])
        last = np.where(lacks[:-1].any(axis=0), lacks.argmax(axis=0) + 1, len(matches))
        complete = np.maximum.accumulate(decided)[last, np.arange(len(keys))]
        for match in matches:
            if match.queue.is_unstamped:
                match.arrive_until(np.maximum.accumulate(complete))

    def _account(self, keys: IntArray, is_sample: BoolArray, pace: Queue, matches: Sequence[Match]) -> None:
        """Count what was lost, and let the streams keep what may still join a sample."""
        lacking = ~is_sample
        for match in matches:
            is_sensor = match.queue.stream in self._sensors
            missing = ~match.has_value & (lacking if is_sensor else is_sample)
            match.queue.stream.losses.missing += int(missing.sum())
            if is_sensor:
                lacking = lacking & match.has_value
            match.keep(is_sample)
        pace.keep(len(keys), int(is_sample.sum()))
        for match in matches:
            if len(match.queue.stamps_ns) and not self._sensors[0].buffer:
                match.queue.stream.forget(self._horizon)
        if is_sample.any():
            self.delivered += int(is_sample.sum())
            self._last_delivered = int(keys[is_sample][-1])
