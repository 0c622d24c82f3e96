"""Messages and samples as arrays, and how many of sensor 1's samples were used, and when that is too few."""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from itertools import repeat
from operator import itemgetter
from typing import Any, get_args

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.alternation import alternations
from tam_calibration.core.interpolation import LARGEST_ERROR
from tam_calibration.messages.cdr import COUNT
from tam_calibration.messages.missing import MOST_MISSING, are
from tam_calibration.messages.stream import InterpolatedStream, Losses, Stream, sensor_stream
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import Mounting, Turn
from tam_calibration.model.recording import LAGS, InterpolatedNoise, Recording, SampleSource
from tam_calibration.model.units import FloatArray, IntArray, to_degrees, to_nanotesla


@dataclass(frozen=True)
class Usage:
    """How many of sensor 1's samples were used.

    Parameters
    ----------
    used : int
        Samples that all sensors joined.
    received : int
        Messages of sensor 1, also those that were lost on the way, but for those that still wait, and those of the
        sensor that stood in for it.
    reasons : tuple of str
        Why the others were not used, each with its count and what to do, the most frequent first.
    readings : tuple of int
        Readings that came of each sensor.
    interpolated : tuple of int
        Samples in which the value of each sensor lies between its readings.
    unfinished : str
        How a recorder left the recording, as a clause; empty where it was finished.
    lost : tuple of str
        The channels most of whose messages cannot be used, each with why.
    scalar_is_lost : bool
        Whether the scalar is one of them.
    missing : tuple of str
        Readings that are missing although a message or row came, a clause for each sensor and reason.
    doubled : tuple of str
        Sensors on whose topics two publishers send, a clause for each.
    other_frames : tuple of str
        A warning of each stream whose messages are of another frame than the array file states, and of an order of
        sensors that is not certain.
    correlation : tuple of tuple of float
        Of the noise of each sensor that interpolation makes, of values that lie 1 to ``LAGS`` apart.
    """

    used: int
    received: int
    reasons: tuple[str, ...] = ()
    readings: tuple[int, ...] = ()
    interpolated: tuple[int, ...] = ()
    unfinished: str = ""
    lost: tuple[str, ...] = ()
    scalar_is_lost: bool = False
    missing: tuple[str, ...] = ()
    doubled: tuple[str, ...] = ()
    other_frames: tuple[str, ...] = ()
    correlation: tuple[tuple[float, ...], ...] = field(default=(), compare=False)

    @classmethod
    def of(cls, used: int, sensors: Sequence[Stream], channels: Sequence[Stream], patience_ns: int) -> "Usage":
        """Return the usage that the streams of the sensors tell.

        Parameters
        ----------
        used : int
            Samples that were made.
        sensors : sequence of Stream
            Of sensors 1 to K.
        channels : sequence of Stream
            Of the channels recorded with the sensors.
        patience_ns : int
            How far the stamps of one may lag behind those of another, nanoseconds.
        """
        first = sensors[0]
        own = _own_faults(first)
        reasons = [(count, f"{count} {fault}: look at the driver of {first.name}") for count, fault in own]
        reasons.append((first.losses.lost, f"{first.losses.lost} were lost on the way: look at the load"))
        newest = max(sensors, key=lambda stream: stream.timeline.newest_ns)
        for stream in sensors:
            reasons.append((stream.losses.missing, _why_missing(stream, first, newest, patience_ns)))
        counted = sorted((reason for reason in reasons if reason[0]), key=lambda reason: -reason[0])
        waiting = len(first.buffer) + len(first.timeline.doubtful)
        interpolated = [stream for stream in sensors if isinstance(stream, InterpolatedStream)]
        lost = {stream.name: why for stream in channels if (why := why_lost(stream))}
        return cls(
            used,
            first.losses.received + first.losses.lost - waiting + first.losses.missing,
            tuple(text for _, text in counted),
            tuple(stream.losses.received - stream.losses.unusable for stream in sensors),
            (0, *(stream.interpolated for stream in interpolated)),
            lost=tuple(lost.values()),
            doubled=tuple(why for stream in sensors if (why := why_doubled(stream.name, stream.losses))),
            scalar_is_lost="scalar" in lost,
            correlation=((0.0,) * LAGS, *(tuple(stream.correlation().values.tolist()) for stream in interpolated)),
        )

    @classmethod
    def from_json(cls, text: str) -> "Usage":
        """Return the usage that `to_json` wrote; keys that only another version knows are left out.

        Raises
        ------
        InputError
            When the text is not of such a usage.
        """
        with suppress(ValueError, TypeError):
            content = json.loads(text)
            known = [each for each in fields(cls) if each.name in content]
            return cls(**{each.name: _of_type(each.type, content[each.name]) for each in known})
        raise InputError("the collector is of another version than the calibrator: start both from one installation")

    def to_json(self) -> str:
        """Return the usage as text for other processes."""
        return json.dumps(asdict(self), ensure_ascii=False)

    def __str__(self) -> str:
        """Return the usage as a clause for people; empty where no messages are known."""
        if not self.received:
            return ""
        why = f": {'; '.join(self.reasons)}" if self.reasons else ""
        return f"{self.used} of {self.received} samples of sensor 1 used{why}"

    def require_enough(self) -> None:
        """Check that enough was used for a fit.

        Raises
        ------
        Refused
            When less than half of the samples were used, two publishers send on the topic of a sensor, or the scalar,
            which determines the scale, is lost.
        """
        if self.doubled:
            raise Refused("; ".join(self.doubled))
        # If more is lost than used, the rest may join by chance, as with clocks that differ.
        if self.used < (1 - MOST_MISSING) * self.received:
            raise Refused(f"only {self}; correct that and record again")
        if self.scalar_is_lost:
            raise Refused(f"{'; '.join(self.lost)}: correct that, or leave the topic out")

    def warnings(self) -> tuple[str, ...]:
        """Return warnings: few samples, an unfinished recording, channels that are lost, messages of other frames."""
        # Above it standard errors are within 5 % of those with all samples.
        few = (f"only {self}",) if self.used < 0.9 * self.received else ()
        return (*few, *((self.unfinished,) if self.unfinished else ()), *self.lost, *self.other_frames)

    def with_each_reading_once(self, samples: SampleSource) -> SampleSource:
        """Return samples for a fit, thinned where a sensor that is read less often would count more than once.

        Samples with a scalar reading stay, without their neighbours, one for each reading of the slowest sensor. All
        tell what interpolation made of their noise.

        Parameters
        ----------
        samples : SampleSource
            As they were joined.

        Raises
        ------
        Refused
            Where the readings that would be thinned are those of two publishers in turn.
        """
        if not any(self.interpolated):
            return samples
        rates = np.array(self.readings) / max(self.received, 1)
        # Standard errors then stay within 5 %, although some readings count twice.
        if rates.min() > 0.9:
            return samples.with_noise(self._noise(rates, 1.0))
        if mixed := alternations(next(iter(samples.blocks())).readings_T):
            raise Refused(f"{'; '.join(mixed.values())}: stop one of them and record again")
        count = samples.sample_count
        stride = round(1 / max(float(rates.min()), 1 / count))
        times, scalars = zip(*((block.time_s, block.scalar_T) for block in samples.blocks()), strict=True)
        time_s = np.concatenate(times)
        # The first of each stretch of time, so that those stay that hold readings as they came.
        stretch = np.floor(((time_s - time_s[0]) / np.median(np.diff(time_s)) + 0.5) / stride)
        kept = np.diff(stretch, prepend=-1) > 0
        if scalars[0] is not None:
            scalar = np.flatnonzero(np.isfinite(np.concatenate(scalars)))
            with_scalar = np.zeros(count, dtype=bool)
            with_scalar[scalar[np.unique(stretch[scalar], return_index=True)[1]]] = True
            is_near = np.convolve(with_scalar, np.ones(2 * stride - 1), "same") > 0
            kept = with_scalar | (kept & ~is_near)
        return samples.take(kept).with_noise(self._noise(rates, count / kept.sum()))

    def _noise(self, rates: FloatArray, apart: float) -> InterpolatedNoise:
        """Return what interpolation made of the noise, from the readings (K,) in a sample and the distance of samples.

        Of a slow sensor the samples that hold a reading as it came are those that are kept.
        """
        values_apart = np.maximum(np.rint(1 / np.maximum(rates, 1e-9)), 1)
        as_read = 1 - np.minimum(np.array(self.interpolated) / max(self.used, 1), 1)
        parts = 1 - np.minimum(as_read * values_apart, 1)
        at, places = np.outer(apart / values_apart, np.arange(1, LAGS + 1)), np.arange(LAGS + 1)
        correlation = self.correlation or ((0.0,) * LAGS,) * len(rates)
        known = [np.interp(own, places, [1, *each], right=0) for own, each in zip(at, correlation, strict=True)]
        return InterpolatedNoise(parts[:, None] * np.array(known), rates * apart)

    def interpolation_warnings(self, samples: SampleSource, noise_T: FloatArray) -> tuple[str, ...]:
        """Return a warning of each sensor whose interpolated values are wrong by more than its noise hides in a fit.

        Parameters
        ----------
        samples : SampleSource
            With each reading once; a thousand of those of sensor 1 tell how fast the array turned.
        noise_T : (K,) array
            Of each axis of the sensors, tesla.
        """
        noise = samples.interpolated_noise
        if noise is None:
            return ()
        first, last = samples.time_span_s
        pace_s = (last - first) / max(samples.sample_count - 1, 1)
        rate, field_T = _turning(samples)
        warnings = []
        for sensor in np.flatnonzero(self.interpolated).tolist():
            period_s = pace_s / float(noise.readings_per_sample[sensor])
            error_T = LARGEST_ERROR * float(np.sqrt(np.mean((rate * period_s) ** 8))) * field_T
            # From 1.5 times the noise of the mean of all samples on, fits err by a tenth more than they tell.
            if error_T * np.sqrt(samples.sample_count) > 1.5 * noise_T[sensor]:
                fastest = to_degrees(float(rate.max()))
                warnings.append(
                    f"sensor {sensor + 1} is read at {1 / period_s:.3g} Hz while the array turns at up to "
                    f"{fastest:.0f}°/s: its interpolated readings are wrong by {to_nanotesla(error_T):.2g} nT (RMS), "
                    "beyond the standard errors; turn more slowly, or read it faster"
                )
        return tuple(warnings)

    def remarks(self) -> tuple[str, ...]:
        """Return the warnings and what is missing as complete sentences.

        Raises
        ------
        Refused
            As ``require_enough``.
        """
        self.require_enough()
        return tuple(f"{warning[0].upper()}{warning[1:]}." for warning in (*self.warnings(), *self.missing))


NO_USAGE = Usage(0, 0)
"""Of samples that were not joined of messages, and of which nothing is missing."""


def _of_type(kind: Any, value: Any) -> Any:
    """Return the value of JSON as a field has it.

    Raises
    ------
    TypeError
        When it is of another type.
    """
    if parts := get_args(kind):
        if not isinstance(value, list):
            raise TypeError
        return tuple(_of_type(parts[0], each) for each in value)
    if type(value) is not kind:
        raise TypeError
    return value


def _turning(samples: SampleSource) -> tuple[FloatArray, float]:
    """Return the rates (n,) at which the field turns in the frame of sensor 1, rad/s, and its mean intensity, tesla."""
    rates, fields = [], []
    for block in samples.blocks():
        field_T = block.readings_T[:, 0]
        length = np.linalg.norm(field_T, axis=1)
        turn = np.linalg.norm(np.diff(field_T, axis=0), axis=1) / np.maximum(length[1:], np.finfo(float).tiny)
        rates.append(turn / np.diff(block.time_s))
        fields.append(length)
    rate = np.concatenate(rates)
    return rate[:: -(-len(rate) // 1000)], float(np.concatenate(fields).mean())


def why_doubled(name: str, losses: Losses) -> str:
    """Return why the messages of a sensor are those of two publishers, with what to do; empty where they are not."""
    if losses.contradicting <= 0.1 * losses.received:
        return ""
    return (
        f"{losses.contradicting} of {losses.received} messages of {name} repeat the stamp before with other values, as "
        "those of two publishers on one topic: stop one of them and record again"
    )


def why_lost(stream: Stream) -> str:
    """Return why most messages of a stream cannot be used, in one clause; empty where they can.

    Parameters
    ----------
    stream : Stream
        Of a sensor or a channel.
    """
    faults = [(count, fault) for count, fault in _own_faults(stream) if count]
    if sum(count for count, _ in faults) <= 0.5 * stream.losses.received:
        return ""
    zero = ": all its stamps are zero" if stream.timeline.newest_ns == 0 else ""
    listed = ", ".join(f"{count} {fault}" for count, fault in faults)
    return f"of {stream.losses.received} messages of {stream.name} {listed}{zero}"


def _own_faults(stream: Stream) -> list[tuple[int, str]]:
    losses = stream.losses
    return [
        (losses.duplicate, "repeat the stamp before"),
        (losses.late, "have stamps out of order"),
        (losses.implausible, "have false stamps"),
        *((count, are(code, count, stream.name)) for code, count in losses.faults.items()),
    ]


def _why_missing(stream: Stream, first: Stream, newest: Stream, patience_ns: int) -> str:
    """Return why samples have nothing of a sensor: nothing came, nothing usable, not in time, or not all."""
    losses, name = stream.losses, stream.name
    if not losses.received:
        return f"nothing arrived from {name}: check sensor, cable, driver and topic"
    lacking = f"{losses.missing} found none of {name}"
    if losses.implausible + losses.unusable + losses.duplicate > losses.missing // 2:
        return f"{lacking}, most of whose messages cannot be used: {losses.explain()}"
    limit_ns = max(patience_ns, stream.timeline.reach_ns)
    advice = "stopped, or their clocks differ; synchronise the clocks, or state delay_s in the array file"
    behind_ns = newest.timeline.newest_ns - stream.timeline.newest_ns
    if behind_ns > limit_ns:
        return f"{lacking}, whose newest stamp is {behind_ns / 1e9:.3g} s behind that of {newest.name}: it {advice}"
    ahead_ns = stream.timeline.newest_ns - first.timeline.newest_ns
    if ahead_ns > limit_ns:
        return f"{lacking}, whose newest stamp is {ahead_ns / 1e9:.3g} s ahead of that of {first.name}: that {advice}"
    if 2 * losses.silent > losses.missing:
        return f"{lacking}, which was silent in {losses.silent} of them: check sensor, cable and driver"
    why = f"{losses.lost} were lost on the way" if losses.lost else "they have gaps, or come too late"
    return f"{lacking}, of which {losses.received} messages came: {why}; look at the load"


BoolArray = NDArray[np.bool_]


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
        if self.stamps_ns is None or not delay_ns:
            return self
        return replace(self, stamps_ns=self.stamps_ns - delay_ns)

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


def in_order(batch: Mapping[str, StreamMessages]) -> list[tuple[str, int | None, list[float], int]]:
    """Return the messages of streams in the order in which they arrived.

    Returns
    -------
    list of tuple
        Stream, stamp (None without), values, and when it arrived.
    """
    messages: list[tuple[int, str, int | None, list[float], int]] = []
    for name, each in batch.items():
        stamps = repeat(None) if each.stamps_ns is None else each.stamps_ns.tolist()
        arrived, values = each.arrivals_ns.tolist(), each.values.tolist()
        messages += zip(each.order.tolist(), repeat(name), stamps, values, arrived, strict=False)
    return [message[1:] for message in sorted(messages, key=itemgetter(0))]


def turns_of(mounting: Mounting) -> dict[str, Turn]:
    """Return what turns the values of a message, by stream; the others' are as they are."""
    turns = {sensor_stream(sensor + 1): turn for sensor, turn in mounting.sensor_turns.items()}
    of_imu = {"attitude": mounting.attitude_turn, "gyroscope": mounting.rate_turn}
    return turns | {stream: turn for stream, turn in of_imu.items() if turn is not None}


def expected_frames(mounting: Mounting) -> dict[str, str]:
    """Return the frame that the messages of each stream must have, as far as an array file names it."""
    frames = {sensor_stream(sensor): frame for sensor, frame in enumerate(mounting.frame_ids or (), 1)}
    return frames | ({"attitude": mounting.imu_frame_id} if mounting.imu_frame_id else {})


def other_frame(stream: str, frame: str, stated: str) -> str:
    """Return a warning of messages of another frame than the array file states, with what to do."""
    return (
        f"the messages of {stream} are of the frame {frame or 'without name'}, the array file says {stated}: name the "
        "topics in a map, or correct frame_ids"
    )


Progress = Callable[[int, int], None]
"""Called now and then with the bytes that are done, and how many there are to do."""


def pieces(sample_count: int) -> Iterator[slice]:
    """Yield the slices that cut so many samples into pieces, so that what is written of a piece stays small."""
    for start in range(0, sample_count, COUNT):
        yield slice(start, min(start + COUNT, sample_count))


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of a recording.

    Parameters
    ----------
    recording : Recording
        The samples.
    stamps_ns : (N,) array of int, optional
        Stamps of their messages, nanoseconds; None where they were no messages.
    usage : Usage
        How many of sensor 1's messages were used so far.
    missing : (N,) array of int, optional
        Which sensors each sample lacks, bit k for sensor k + 1; their readings are the mean of the others'. None
        where no sample lacks any.
    """

    recording: Recording
    stamps_ns: IntArray | None = None
    usage: Usage = NO_USAGE
    missing: IntArray | None = None


def stamps_of(time_s: FloatArray) -> IntArray:
    """Return times as whole nanoseconds.

    Raises
    ------
    InputError
        When a time cannot be the stamp of a message: before 1970 or after 2038.
    """
    if time_s[0] < 0 or time_s[-1] >= 2**31:
        raise InputError(
            f"the times {time_s[0]} to {time_s[-1]} s cannot be stamps of messages: they must lie between 0 and 2³¹ s"
        )
    seconds = np.floor(time_s)
    nanoseconds = np.rint((time_s - seconds) * 1e9)
    stamps_ns: IntArray = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds.astype(np.int64)
    return stamps_ns


def seconds_of(stamps_ns: IntArray) -> FloatArray:
    """Return stamps in seconds, each rounded correctly: whole nanoseconds are beyond what doubles hold.

    From 1987 on the sum of seconds and fraction is: no fraction lies so near to the middle between two such doubles
    that its own rounding, 2⁻⁵⁴ at most, would carry it across.
    """
    seconds, fraction = np.divmod(stamps_ns, 1_000_000_000)
    # From here on the sum of seconds and fraction is rounded correctly.
    if len(stamps_ns) and seconds.min() >= 1 << 29:
        return np.asarray(seconds + fraction / 1e9)
    return np.array([stamp / 1_000_000_000 for stamp in stamps_ns.tolist()])
