"""Joining the messages of several topics into samples by their stamps: one algorithm for live nodes and for bags.

Sensor 1 sets the pace: each of its messages makes a sample with the nearest message of every other sensor within a
tolerance, unless that message is nearer to the next one of sensor 1: after a loss no stream takes what belongs to the
next sample, whatever the tolerance. Samples go on without a sensor that is silent: see `silence`. The streams arrive
each in its own order but interleaved in any way; the samples do not depend on how, as long as no stream lags behind
another by more than the patience, but for those with which a silent sensor returns. Time is that of the stamps. A stamp
that jumps is believed when the next one of its stream follows it: see `timeline`.

Times of arrival, where they are known, show a stall: messages come later than their stamps tell, because the process or
the network stood still. What waited meanwhile comes in a burst, one stream after another, and samples wait for all.
"""

import math
from collections import deque
from collections.abc import Collection, Sequence
from typing import NamedTuple

import numpy as np

from tam_calibration.messages import stream as streams
from tam_calibration.messages.point_cloud import SampleLayout, columns_of
from tam_calibration.messages.samples import Usage, why_lost
from tam_calibration.messages.stream import BEFORE_ALL, EPOCH, HeldStream, JoinedStream, Message, Stream
from tam_calibration.messages.timeline import STEP_NS, StampStep
from tam_calibration.model.units import FloatArray

_MAXIMUM_AGE_NS = {"temperature": 60_000_000_000, "attitude": 200_000_000, "gyroscope": 200_000_000}
"""How old the newest value of a held channel may be; of the others two seconds."""

CATCH_UP_NS = 1_000_000_000
"""Time of arrival for which samples wait for all streams after a stall: ten times what was measured after 8 s."""

REMEMBERED = 16
"""Intervals between samples, the shortest of which decides when a message may be of the next sample."""

_NO_READING = (math.nan, math.nan, math.nan)


class Sample(NamedTuple):
    """One synchronised sample.

    Parameters
    ----------
    stamp_ns : int
        Stamp of sensor 1, or of the sensor that replaces it; strictly increasing within an epoch.
    epoch : int
        Grows when stamps stepped back: a clock that was set, a driver that restarted, a bag that loops.
    values : tuple of float
        The columns of `SampleLayout` after ``time_s``; NaN where a channel had no value, or a sensor is silent.
    """

    stamp_ns: int
    epoch: int
    values: tuple[float, ...]


class Synchroniser:
    """Joins the messages of K sensors and the channels recorded with them into samples in the order of their stamps.

    Parameters
    ----------
    layout : SampleLayout
        Number of sensors, and the channels that a sample contains.
    tolerance_ns : int
        Greatest difference of stamps within a sample.
    patience_ns : int
        How far in stamps a stream may lag behind the newest sensor before samples go without it.
    hold_patience_ns : int
        The same for held channels (temperature, current, attitude, gyroscope): 0 takes what has arrived, without delay.
    scalar_is_held : bool
        Whether the scalar's messages have no stamp: each joins the next sample, instead of that of its stamp.
    expected : collection of str
        Channels that are waited for from the first sample; others once they have been seen.
    capacity : int
        Greatest number of waiting messages of a stream.
    delay_s : (K,) or (K + 1,) array, optional
        How much later than it was read a reading of each sensor, and of the scalar, is stamped, seconds: its stamps are
        set back by that.
    silence_ns : int
        Time in stamps without a message of a sensor after which samples go on without it.
    """

    def __init__(
        self,
        layout: SampleLayout,
        tolerance_ns: int = 0,
        patience_ns: int = 250_000_000,
        hold_patience_ns: int = 0,
        scalar_is_held: bool = False,
        expected: Collection[str] = (),
        capacity: int = 65_536,
        delay_s: FloatArray | None = None,
        silence_ns: int = streams.SILENCE_NS,
    ) -> None:
        self.delivered = self.partial = self.restarts = 0
        self.steps: list[StampStep] = []
        self._patience_ns, self._hold_patience_ns = patience_ns, hold_patience_ns
        self._capacity = capacity
        delays_ns = [] if delay_s is None else np.round(1e9 * delay_s).astype(int).tolist()
        delayed = [*(streams.sensor_stream(index + 1) for index in range(layout.sensor_count)), "scalar"]
        self._delays_ns = {name: delay for name, delay in zip(delayed, delays_ns, strict=False) if delay}
        self._sensors = [JoinedStream(streams.sensor_stream(1), tolerance_ns, True)]
        others = range(2, layout.sensor_count + 1)
        self._sensors += [
            streams.InterpolatedStream(streams.sensor_stream(sensor), tolerance_ns, True) for sensor in others
        ]
        channels: list[Stream] = []
        for name in layout.channels:
            kind = HeldStream if name != "scalar" else streams.OnceStream if scalar_is_held else streams.IntensityStream
            window_ns = tolerance_ns if kind is streams.IntensityStream else _MAXIMUM_AGE_NS.get(name, 2_000_000_000)
            channels.append(kind(name, window_ns, name in expected, len(columns_of(name))))
        self._partners = [*self._sensors[1:], *channels]
        self._streams: dict[str, Stream] = {stream.name: stream for stream in [*self._sensors, *channels]}
        self._epoch = 0
        self._newest = self._horizon = self._hold_horizon = self._last_delivered = self._epoch_start = BEFORE_ALL
        self._previous = self._pending = BEFORE_ALL
        self._now_ns = self._newest_at_ns = self._caught_up_ns = 0
        self._silence = streams.Silence(self._sensors, silence_ns)
        self._intervals: deque[int] = deque(maxlen=REMEMBERED)
        self._waits_for: Stream = self._sensors[0]

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self._sensors)

    @property
    def losses(self) -> dict[str, streams.Losses]:
        """What became of the messages, by stream."""
        return {name: stream.losses for name, stream in self._streams.items()}

    @property
    def usage(self) -> Usage:
        """How many of sensor 1's samples were used, and why not the others."""
        channels = self._partners[len(self._sensors) - 1 :]
        return Usage.of(self.delivered, self._sensors, channels, self._patience_ns)

    @property
    def lost(self) -> list[str]:
        """Why most messages of a sensor cannot be used, a clause for each sensor of which that is so."""
        return [why for stream in self._sensors if (why := why_lost(stream))]

    @property
    def silent(self) -> list[str]:
        """The sensors without which samples go on now."""
        return [stream.name for stream in self._sensors if self._silence.is_dead(stream, self._horizon)]

    @property
    def drops_everything(self) -> bool:
        """Whether messages of sensors arrive, but no sample was made of them for long."""
        return self._horizon > max(self._last_delivered, self._epoch_start) + 2 * self._patience_ns

    def push(self, stream: str, stamp_ns: int | None, values: Sequence[float], arrived_ns: int = 0) -> list[Sample]:
        """Take a message and return the samples that it completes.

        Parameters
        ----------
        stream : str
            ``tam_1`` … ``tam_K``, or the channel's name in `SampleLayout`.
        stamp_ns : int or None
            Stamp of the message's header; None for a held channel without stamps, which takes the newest sensor's.
        values : sequence of float
            The values of the stream's columns.
        arrived_ns : int
            When it arrived, on any clock; 0 where that is not known of any message.
        """
        state = self._streams[stream]
        state.losses.received += 1
        self._now_ns = arrived_ns
        if stamp_ns is not None and stream in self._delays_ns:
            stamp_ns -= self._delays_ns[stream]
            if stamp_ns < 0:  # read before the clock of a simulation began
                state.losses.faults[0] += 1
                return []
        if stamp_ns is None or state.timeline.advances(stamp_ns):
            is_stored, is_step = self._admit(state, stamp_ns, values), False
        else:
            is_stored, is_step = self._admit_believed(state, stamp_ns, values)
        is_waiting_over = self._waits_for is state or is_step or self._is_overdue(self._waits_for)
        return self._complete() if is_stored and is_waiting_over else []

    def refuse(self, stream: str, count: int = 1, code: int = 0) -> None:
        """Count messages that cannot be used.

        Parameters
        ----------
        stream : str
            As in `push`.
        count : int
            How many there are.
        code : int
            Why, as in ``missing.REASONS``.
        """
        losses = self._streams[stream].losses
        losses.received += count
        losses.faults[code] += count

    def flush(self) -> list[Sample]:
        """Return the samples that still waited for messages: there will be none."""
        self._horizon = self._hold_horizon = self._newest
        for stream in self._streams.values():
            stream.timeline.give_up()
            stream.losses.implausible = stream.timeline.given_up
        samples = self._complete()
        self._forget((self._epoch + 1) * EPOCH)
        return samples

    def explain_losses(self) -> str:
        """Return one line for people: how many samples were made, and what was lost by which stream and why."""
        parts = [f"{self.delivered} of {self._sensors[0].losses.received} samples synchronised"]
        if self.partial:
            parts.append(f"{self.partial} more without a sensor that is silent")
        silent = [stream.name for stream in self._sensors if stream.losses.received == 0]
        if silent:
            parts.append(f"nothing arrived from {', '.join(silent)}")
        heard = [stream for stream in self._streams.values() if stream.losses.received]
        parts += [f"{stream.name}: {losses}" for stream in heard if (losses := stream.losses.explain())]
        if self.restarts:
            parts.append(f"stamps went back {self.restarts} times")
        return "; ".join(parts)

    def _admit_believed(self, stream: Stream, stamp_ns: int, values: Sequence[float]) -> tuple[bool, bool]:
        """Let those messages wait that are believed after one that is no usual next; return whether any, and a step."""
        timeline = stream.timeline
        believed = timeline.take(stamp_ns, values, self._is_expected(stream, stamp_ns))
        stream.losses.implausible = timeline.given_up
        is_step = len(believed) > 1
        if is_step and self._is_first_to_step(stream, believed[0][0]):
            ahead_ns = stamp_ns - (self._newest - self._epoch * EPOCH)
            is_pause = 0 < ahead_ns < 2 * (self._now_ns - self._newest_at_ns)
            self.steps.append(StampStep(stream.name, timeline.jump_ns, is_pause))
        is_stored = [self._admit(stream, *message) for message in believed]
        if is_step:
            self._release()
        return any(is_stored), is_step

    def _is_expected(self, stream: Stream, stamp_ns: int) -> bool:
        """Return whether a stream that jumps to a stamp only follows the sensors: after a pause, or in a new epoch."""
        present = self._newest - self._epoch * EPOCH
        if stream.epoch < self._epoch:
            return abs(stamp_ns - present) <= self._patience_ns
        return stream.timeline.newest_ns < stamp_ns <= present + STEP_NS

    def _is_first_to_step(self, stream: Stream, stamp_ns: int) -> bool:
        """Return whether a stream steps to a stamp before the others: any stream back, a sensor ahead."""
        if stream.timeline.jump_ns < 0:
            return stream.epoch == self._epoch
        return stream in self._sensors and not self._is_expected(stream, stamp_ns)

    def _release(self) -> None:
        """Take the doubtful messages of streams that make the step that another has just confirmed."""
        for stream in self._streams.values():
            doubtful = stream.timeline.doubtful
            if doubtful and self._is_expected(stream, doubtful[0][0]):
                for message in stream.timeline.believe():
                    self._admit(stream, *message)

    def _admit(self, stream: Stream, stamp_ns: int | None, values: Sequence[float]) -> bool:
        """Let a message wait for its sample; return whether it is one that can join."""
        key = self._key(stream, stamp_ns)
        if key is None:
            is_repeat = stamp_ns is not None and stream.epoch * EPOCH + stamp_ns == stream.newest
            stream.losses.contradicting += is_repeat and tuple(values) != tuple(stream.newest_values)
            return False
        self._store(stream, key, values)
        return True

    def _key(self, stream: Stream, stamp_ns: int | None) -> int | None:
        """Return the place of a message in the order of all messages, or None where it is thrown away."""
        if stamp_ns is None:
            kept = stream.kept if isinstance(stream, HeldStream) else 1
            if len(stream.buffer) >= kept and stream.buffer[-kept][0] == self._newest:
                del stream.buffer[-kept]
            return self._newest
        key = stream.epoch * EPOCH + stamp_ns
        if key > stream.newest:
            if stream.epoch == self._epoch or stamp_ns <= stream.rejoins_after:
                return key
        elif key == stream.newest:
            stream.losses.duplicate += 1
            return None
        elif key > stream.newest - STEP_NS:
            stream.losses.late += 1
            return None
        elif stream.epoch == self._epoch:
            self._begin_epoch(stream)
        stream.epoch = self._epoch
        return self._epoch * EPOCH + stamp_ns

    def _begin_epoch(self, beginner: Stream) -> None:
        """Begin a new epoch: the other streams join it when they step back too, or have run on past the patience."""
        self._epoch += 1
        self.restarts += 1
        newest = {stream: stream.newest - stream.epoch * EPOCH for stream in self._streams.values()}
        sensors = max((newest[stream] for stream in self._sensors if stream is not beginner), default=0)
        for stream in self._streams.values():
            if newest[stream] >= 0:
                stream.rejoins_after = max(newest[stream], sensors) + self._patience_ns

    def _store(self, stream: Stream, key: int, values: Sequence[float]) -> None:
        stream.newest, stream.newest_values = key, values
        stream.buffer.append((key, values))
        if len(stream.buffer) > self._capacity:
            stream.buffer.popleft()
            stream.losses.unmatched += 1
        if stream not in self._sensors:
            stream.awaited = True
        elif key > self._newest:
            if key - self._newest > self._silence.limit_ns:
                self._silence.begin(key)
            late_ns = self._now_ns - self._newest_at_ns - (key - self._newest)
            self._advance(key)
            self._newest_at_ns = self._now_ns
            if late_ns > self._patience_ns and not self._is_catching_up(self._now_ns):
                self._caught_up_ns = self._now_ns + CATCH_UP_NS
        if not self._sensors[0].buffer:
            stream.forget(self._horizon)

    def _advance(self, key: int) -> None:
        """Move time on to the newest stamp of the sensors; at the start of an epoch patience begins anew."""
        if key - self._newest > EPOCH // 2:
            self._epoch_start = key
        self._newest = key
        if self._is_catching_up(self._now_ns):
            return
        if key >= self._epoch_start + self._patience_ns:
            self._horizon = key - self._patience_ns
        if key >= self._epoch_start + self._hold_patience_ns:
            self._hold_horizon = key - self._hold_patience_ns

    def _is_catching_up(self, now_ns: int) -> bool:
        """Return whether streams may still lag after a stall; not where the clock of arrival was set back."""
        return 0 < self._caught_up_ns - now_ns <= CATCH_UP_NS

    def _is_overdue(self, stream: Stream) -> bool:
        return self._pending <= (self._hold_horizon if isinstance(stream, HeldStream) else self._horizon)

    def _complete(self) -> list[Sample]:
        """Return the samples that are decided, oldest first."""
        samples = []
        first = self._sensors[0]
        self._waits_for = first
        while (pace := self._pace()) is not None and (partners := self._find_partners(pace)) is not None:
            key, values = pace.buffer.popleft() if pace is first else (self._pending, _NO_READING)
            self._intervals.append(key - self._previous)
            self._previous = key
            first.losses.missing += pace is not first
            for stream, message in zip(self._partners, partners, strict=False):
                stream.losses.missing += message is None
            is_whole = pace is first and None not in partners[: len(self._sensors) - 1]
            if is_whole or self._goes_on(pace, key, partners):
                samples.append(self._join(key, values, partners))
                self.delivered += is_whole
                self.partial += not is_whole
                if not is_whole:
                    first.losses.silent += pace is not first
                    for stream, message in zip(self._partners, partners, strict=False):
                        stream.losses.silent += message is None
            else:
                first.losses.unmatched += pace is first
                self._forget(key)
            if pace is first:
                self._silence.hear_first(key)
        return samples

    def _pace(self) -> JoinedStream | None:
        """Return the sensor whose oldest message makes the next sample, and keep its stamp; None: there is none."""
        first = self._sensors[0]
        if first.buffer and first.buffer[0][0] <= self._previous:
            first.skip(self._previous)
        missed_after = self._silence.first_missed_after
        pace: JoinedStream | None = first if first.buffer else None
        if first.buffer[0][0] > missed_after if first.buffer else self._horizon > missed_after:
            pace = self._silence.stand_in(max(missed_after, self._previous), self._horizon) or pace
        self._pending = missed_after if pace is None else pace.buffer[0][0]
        return pace

    def _goes_on(self, pace: Stream, key: int, partners: Sequence[Message | None]) -> bool:
        """Return whether all sensors that a sample lacks are silent, and two or more are there."""
        others = partners[: len(self._sensors) - 1]
        lacking = [stream for stream, message in zip(self._sensors[1:], others, strict=False) if message is None]
        count = (pace is self._sensors[0]) + len(others) - len(lacking)
        return count > 1 and all(self._silence.is_silent(stream, key) for stream in lacking)

    def _forget(self, before: int) -> None:
        for stream in self._partners:
            stream.forget(before)

    def _find_partners(self, pace: JoinedStream) -> list[Message | None] | None:
        """Return what joins the oldest message of a sensor, up to one that has nothing to join; None: not yet decided.

        A sensor that is silent is passed over.
        """
        partners: list[Message | None] = []
        pending, key = pace.buffer, pace.buffer[0][0]
        shortest = self._shortest_interval(key)
        for stream in self._partners:
            stream.reach(shortest // 2)
            is_decided, message = stream.find(key, self._is_overdue(stream))
            if not is_decided and stream in self._sensors and self._silence.is_dead(stream, self._horizon):
                is_decided, message = stream.find(key, True)
            if not is_decided:
                self._waits_for = self._last_to_come(key, stream)
                return None
            if message is not None and message[0] > key and 2 * (message[0] - key) >= shortest:
                if len(pending) == 1 and not self._is_overdue(pace):
                    self._waits_for = pace
                    return None
                if len(pending) > 1 and abs(pending[1][0] - message[0]) < message[0] - key:
                    message = None
            message = message or stream.between(key)
            partners.append(message)
            if message is None and stream in self._sensors and not self._silence.is_silent(stream, key):
                break
        return partners

    def _last_to_come(self, key: int, undecided: Stream) -> Stream:
        """Return the last of the streams that a sample waits for, so that not each of their messages is a new look."""
        for stream in reversed(self._partners):
            is_to_come = stream.awaited and stream.newest < key and not self._is_overdue(stream)
            if is_to_come and not (stream in self._sensors and self._silence.is_dead(stream, self._horizon)):
                return stream
        return undecided

    def _shortest_interval(self, key: int) -> int:
        """Return the shortest of the intervals that are remembered at a sample; 0 where they are too few."""
        return 0 if len(self._intervals) < REMEMBERED else min(key - self._previous, *self._intervals)

    def _join(self, key: int, values: Sequence[float], partners: list[Message | None]) -> Sample:
        joined = list(values)
        for stream, message in zip(self._partners, partners, strict=True):
            joined += (math.nan,) * stream.width if message is None else message[1]
            if message is not None:
                stream.take(message)
        self._last_delivered = key
        return Sample(key % EPOCH, key // EPOCH, tuple(joined))
