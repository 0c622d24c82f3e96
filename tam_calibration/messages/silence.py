"""Which sensors are silent, so that samples go on without them, and which one sets the pace while sensor 1 is.

A sensor is silent at a stamp that is later than its last message by more than a stated time. Time is that of the
stamps: when all sensors pause, or their clocks step ahead, silence counts from the stamp at which the first goes on.
That no message is still to come is known of stamps behind the horizon. A sensor that is silent at the horizon is dead:
samples no longer wait for it, so that the first after its return may still lack it.
"""

from collections.abc import Sequence

from tam_calibration.messages.stream import InterpolatedStream, JoinedStream, Stream
from tam_calibration.messages.timeline import NEVER

BEFORE_ALL = -(1 << 64)
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
