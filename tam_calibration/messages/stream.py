"""The messages of one topic that wait to join a sample, what is lost of them, and which sensors are silent.

A message has a key: its stamp, raised by more than any stamp with each epoch, so that one number orders all messages.
"""

from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tam_calibration.core.interpolation import BEFORE, Correlation, is_even, weights
from tam_calibration.messages.timeline import NEVER, Timeline

Message = tuple[int, Sequence[float]]
"""Key and values."""


def sensor_stream(sensor: int) -> str:
    """Return the name of the stream of a sensor, 1 to K."""
    return f"tam_{sensor}"


@dataclass
class Losses:
    """What became of the messages of one stream.

    Parameters
    ----------
    received : int
        Messages that arrived.
    unmatched : int
        Messages that joined no sample; not counted where a message may be part of several, or of none, without loss.
    duplicate, late : int
        Messages with the same stamp as the one before, or an earlier one.
    contradicting : int
        Of the duplicates, those with other values: they are another publisher's.
    implausible : int
        Messages whose stamp no other of the stream goes on from.
    faults : Counter of int
        Messages that were damaged, or whose stamp or values are none, by the code of why (``missing.REASONS``).
    missing : int
        Samples for which the stream had no message in time: lost for a sensor, NaN for a channel.
    silent : int
        Of these samples, those that went on without the stream, as a sensor was silent.
    lost : int
        Messages that were published but never arrived.
    """

    received: int = 0
    unmatched: int = 0
    duplicate: int = 0
    contradicting: int = 0
    late: int = 0
    implausible: int = 0
    missing: int = 0
    silent: int = 0
    lost: int = 0
    faults: Counter[int] = field(default_factory=Counter)

    @property
    def unusable(self) -> int:
        """Messages of which nothing can be used."""
        return self.faults.total()

    @property
    def dropped(self) -> int:
        """Messages that were thrown away or lost."""
        return self.unmatched + self.duplicate + self.late + self.implausible + self.lost

    def explain(self) -> str:
        """Return the reasons and their counts for people; empty without losses."""
        reasons = {
            "missing in {} samples": self.missing,
            "{} messages joined no sample": self.unmatched,
            "{} repeated stamps": self.duplicate,
            "{} stamps out of order": self.late,
            "{} stamps far from those before and after": self.implausible,
            "{} messages unusable": self.unusable,
            "{} messages lost on the way": self.lost,
        }
        return ", ".join(reason.format(count) for reason, count in reasons.items() if count)


class Stream:
    """The messages of one stream that may still join a sample, oldest first."""

    def __init__(self, name: str, tolerance_ns: int, awaited: bool, width: int = 3) -> None:
        self.name = name
        self.tolerance_ns = self.window_ns = tolerance_ns
        self.awaited = awaited
        self.width = width
        self.losses = Losses()
        self.newest_values: Sequence[float] = ()
        self.timeline = Timeline[Sequence[float]]()
        self.buffer: deque[Message] = deque()
        self.newest = -1
        self.epoch = 0
        self.rejoins_after = -1

    def find(self, key: int, is_overdue: bool) -> tuple[bool, Message | None]:
        """Return whether it is decided which message joins the sample at a stamp, and that message.

        Parameters
        ----------
        key : int
            Of the sample: the stamp of sensor 1, nanoseconds, raised with each epoch; no lower than at calls before.
        is_overdue : bool
            Whether the sample goes without a message rather than wait for one.
        """
        raise NotImplementedError

    def reach(self, half_interval_ns: int) -> None:
        """Set how far messages may be that join as they are: half the interval of samples, where that is known."""

    def between(self, key: int) -> Message | None:
        """Return what the messages before and after a stamp tell of it, where no message joins as it is."""
        return None

    def take(self, message: Message) -> None:
        """Let a message that was found join a sample."""

    def forget(self, before: int) -> None:
        """Drop what cannot join a sample at or after a stamp."""
        raise NotImplementedError


class JoinedStream(Stream):
    """A stream whose messages join one sample each, by the nearest stamp."""

    def find(self, key: int, is_overdue: bool) -> tuple[bool, Message | None]:
        """Return whether it is decided which message joins the sample at a stamp, and the nearest one in the window.

        Parameters
        ----------
        key : int
            Of the sample, as in `Stream.find`; messages that are too old for it, or farther than the next, are dropped.
        is_overdue : bool
            Whether to decide among the messages that are there.
        """
        buffer = self.buffer
        self.forget(key)
        while len(buffer) > 1 and key - buffer[0][0] > abs(buffer[1][0] - key):
            self._drop_oldest()
        if buffer and buffer[0][0] > key + self.window_ns:
            return True, None
        if buffer and (buffer[0][0] >= key or len(buffer) > 1):
            return True, buffer[0]
        if is_overdue or not self.awaited or self.newest >= key + self.window_ns:
            return True, buffer[0] if buffer else None
        return False, None

    def forget(self, before: int) -> None:
        """Drop what cannot join a sample at or after a stamp."""
        self.skip(before - self.window_ns - 1)

    def skip(self, until: int) -> None:
        """Drop the messages up to a stamp."""
        while self.buffer and self.buffer[0][0] <= until:
            self._drop_oldest()

    def take(self, message: Message) -> None:
        """Let a message that was found join a sample."""
        self.buffer.popleft()

    def _drop_oldest(self) -> None:
        self.buffer.popleft()
        self.losses.unmatched += 1


class IntensityStream(JoinedStream):
    """A stream whose messages join the nearest sample: the intensity does not turn with the array."""

    def reach(self, half_interval_ns: int) -> None:
        """Set how far messages may be that join as they are: half the interval of samples, where that is known."""
        self.window_ns = max(self.tolerance_ns, half_interval_ns)


class InterpolatedStream(JoinedStream):
    """A stream with values between its messages too."""

    def __init__(self, name: str, tolerance_ns: int, awaited: bool) -> None:
        super().__init__(name, tolerance_ns, awaited)
        self.past: deque[Message] = deque(maxlen=BEFORE)
        self.interpolated = self._passed = 0
        self._correlation = Correlation()
        self._uncounted: list[tuple[int, tuple[float, ...]]] = []
        self._weights: tuple[float, ...] = ()

    def between(self, key: int) -> Message | None:
        """Return what the messages before and after a stamp tell of it, where no message joins as it is."""
        if len(self.past) < BEFORE or not self.buffer:
            return None
        messages = [*self.past, self.buffer[0]]
        stamps = [float(stamp - key) for stamp, _ in messages]
        # Where sensor 1 lags, what the others said after the stamp may have passed already.
        if stamps[-2] > 0 or stamps[-1] <= 0 or not is_even(*stamps):
            return None
        oldest, first, second, third, after = self._weights = weights(*stamps)
        columns = zip(*(values for _, values in messages), strict=True)
        return key, tuple(oldest * a + first * b + second * c + third * d + after * e for a, b, c, d, e in columns)

    def take(self, message: Message) -> None:
        """Let a message that was found join a sample."""
        if self.buffer and message is self.buffer[0]:
            self._drop_oldest()
        else:
            self.interpolated += 1
            self._uncounted.append((self._passed, self._weights))
            # Summing many at once takes a hundredth of the time.
            if len(self._uncounted) == 1024:
                self.correlation()

    def correlation(self) -> Correlation:
        """Return that of the noise of the values that were interpolated so far."""
        if self._uncounted:
            after, weight = zip(*self._uncounted, strict=True)
            self._correlation.add(np.array(after), np.array(weight))
            self._uncounted.clear()
        return self._correlation

    def _drop_oldest(self) -> None:
        self.past.append(self.buffer.popleft())
        self._passed += 1


class HeldStream(Stream):
    """A stream whose newest value is valid until the next, for a limited time."""

    kept = 1
    """Messages up to the stamp of a sample that may join it or later ones."""

    def find(self, key: int, is_overdue: bool) -> tuple[bool, Message | None]:
        """Return whether it is decided which message joins the sample at a stamp, and the newest one until then.

        Parameters
        ----------
        key : int
            Of the sample, as in `Stream.find`; a message older than the window does not join it.
        is_overdue : bool
            Whether to decide among the messages that are there.
        """
        if self.newest < key and self.awaited and not is_overdue:
            return False, None
        self.forget(key)
        return True, self.buffer[0] if self.buffer and self.buffer[0][0] <= key else None

    def forget(self, before: int) -> None:
        """Drop what cannot join a sample at or after a stamp."""
        while len(self.buffer) > self.kept and self.buffer[self.kept][0] <= before:
            self.buffer.popleft()
        while self.buffer and self.buffer[0][0] < before - self.window_ns:
            self.buffer.popleft()


class OnceStream(HeldStream):
    """A stream without stamps whose messages join one sample each: the next, or of two that came at once the next two.

    So a stream at the rate of the samples loses none, in whatever order it and the sensors arrive.
    """

    kept = 2

    def take(self, message: Message) -> None:
        """Let a message that was found join a sample."""
        self.buffer.popleft()


EPOCH = 1 << 64
"""Distance of the keys of successive epochs: more than any stamp, so that one number orders all messages."""

BEFORE_ALL = -EPOCH
"""A key before all others."""


SILENCE_NS = 2_000_000_000
"""Time without a message after which samples go on without a sensor: two periods of one that is read at 1 Hz."""


class Silence:
    """The silence of the sensors of an array.

    Parameters
    ----------
    sensors : sequence of JoinedStream
        Streams of sensors 1 to K.
    silence_ns : int
        Time without a message after which a sensor is silent, nanoseconds.
    """

    def __init__(self, sensors: Sequence[JoinedStream], silence_ns: int) -> None:
        self._sensors = sensors
        # An array of two goes on with neither: a single sensor does not determine the centre.
        self.limit_ns = silence_ns if len(sensors) >= 3 else NEVER
        self._since = BEFORE_ALL
        self.first_missed_after = BEFORE_ALL

    def begin(self, key: int) -> None:
        """Count silence anew from a message that comes after a pause of all sensors, a step ahead or a new epoch.

        Parameters
        ----------
        key : int
            Of the message, later than all before it.
        """
        self._since = key
        self.first_missed_after = key + self.limit_ns

    def hear_first(self, key: int) -> None:
        """Take note of a message of sensor 1 that was decided on."""
        self.first_missed_after = max(self._since, key) + self.limit_ns

    def is_silent(self, stream: Stream, key: int) -> bool:
        """Return whether a sensor that was asked for a stamp, and has nothing to tell of it, is silent there.

        Parameters
        ----------
        stream : Stream
            Of the sensor.
        key : int
            Of the sample.
        """
        return key - self.last(stream) > self.limit_ns

    def last(self, stream: Stream) -> int:
        """Return the key from which the silence of a sensor counts, before what waits of it."""
        if not isinstance(stream, InterpolatedStream):
            return self.first_missed_after - self.limit_ns
        return max(stream.past[-1][0], self._since) if stream.past else self._since

    def is_dead(self, stream: Stream, horizon: int) -> bool:
        """Return whether a sensor is silent at the horizon, so that nothing waits for it."""
        return horizon - max(stream.newest, self._since) > self.limit_ns

    def stand_in(self, after: int, horizon: int) -> JoinedStream | None:
        """Return the sensor that sets the pace while sensor 1 is silent: the first that is not dead.

        A second sensor must have come as far: a single one that is ahead of all others has a different clock.

        Parameters
        ----------
        after : int
            Key up to which there are no more samples.
        horizon : int
            Key that no message falls short of.

        Returns
        -------
        JoinedStream or None
            Its oldest message makes the next sample; None where there is none yet.
        """
        first, *others = self._sensors
        stream = next((each for each in others if not self.is_dead(each, horizon)), None)
        if stream is None:
            return None
        stream.skip(after)
        until = first.buffer[0][0] - 1 if first.buffer else sorted(each.newest for each in self._sensors)[-2]
        return stream if stream.buffer and stream.buffer[0][0] <= until else None
