"""The streams of a recording joined by their stamps into samples, and what was lost in that."""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, pairwise

import numpy as np

from tam_calibration.core.interpolation import AveragedRates
from tam_calibration.correction.streaming import missing_codes
from tam_calibration.messages import samples
from tam_calibration.messages.batch_synchroniser import BatchSynchroniser
from tam_calibration.messages.cdr import NO_TIME
from tam_calibration.messages.missing import Missing
from tam_calibration.messages.point_cloud import SampleLayout, is_channel
from tam_calibration.messages.stream import sensor_stream
from tam_calibration.messages.timeline import Run
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import EARTH_FIELD
from tam_calibration.model.limits import largest_of
from tam_calibration.model.mounting import Mounting
from tam_calibration.model.recording import RATE_COLUMNS
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.recordings.channel_map import Clock, FieldUnit, Pick, Reading
from tam_calibration.recordings.intake import Intake, axes_of
from tam_calibration.recordings.tables import Source, Wanted

PATIENCE_NS = 5_000_000_000
"""How far in stamps the streams of a recording may lag behind each other."""


log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Streams:
    """What is read of a source: for each stream its place, its unit, and whose time it has.

    Parameters
    ----------
    wanted : mapping of str to Wanted
        Table and fields of each stream, sensors first.
    picks : mapping of str to Pick
        Their units, as far as they are stated.
    clock : {"stamp", "received"}
        Whose time the messages have.
    doubtful : mapping of str to str
        Units that a format states, where the size of the field may tell another.
    taken : str
        What was taken for what, for people; empty where that is plain.
    order : str
        Why the order of the sensors is not certain; empty where it is.
    """

    wanted: Mapping[str, Wanted]
    picks: Mapping[str, Pick]
    clock: Clock
    doubtful: Mapping[str, FieldUnit] = field(default_factory=dict)
    taken: str = ""
    order: str = ""

    def other_frames(self, mounting: Mounting) -> tuple[str, ...]:
        """Return a warning of an order that is not certain, and of each stream of a frame that the array has not."""
        doubts = [self.order] if self.order else []
        for stream, stated in samples.expected_frames(mounting).items():
            frames = self.wanted[stream].table.frames if stream in self.wanted else ()
            doubts += [samples.other_frame(stream, frame, stated) for frame in frames if frame != stated]
        return tuple(doubts)

    def intakes(self, reading: Reading, array: Array | None) -> dict[str, Intake]:
        """Return what takes the values of each stream."""
        bounds = EARTH_FIELD if array is None else array.field
        origin = None if reading.origin is None else np.array(reading.origin)
        intakes = {}
        for name, pick in self.picks.items():
            axes = axes_of(self.wanted[name].fields)
            intakes[name] = Intake(name, pick, bounds, reading.unwrap, self.doubtful.get(name, ""), axes, origin)
        return intakes

    def require_half(self, missing: Missing, reading: Reading) -> None:
        """Check that no sensor lacks more than half of its readings or, where samples may be partial, not every sensor.

        Raises
        ------
        InputError
            It names the sensor and why.
        """
        sensors = {name for name in self.wanted if not is_channel(name)}
        if not reading.with_partial or sensors <= missing.mostly().keys():
            missing.require_half()

    @cached_property
    def layout(self) -> SampleLayout:
        """The columns of a sample."""
        channels = tuple(filter(is_channel, self.wanted))
        return SampleLayout(len(self.wanted) - len(channels), channels)

    @property
    def scalar_is_held(self) -> bool:
        """Whether the scalar comes without stamps."""
        scalar = self.wanted.get("scalar")
        return scalar is not None and self.clock == "stamp" and not scalar.table.is_stamped


class Joining:
    """Joins the streams of a source.

    Parameters
    ----------
    source : Source
        An open recording.
    streams : Streams
        What is read of it.
    reading : Reading
        How it is read.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    """

    def __init__(self, source: Source, streams: Streams, reading: Reading, array: Array | None) -> None:
        self.source, self.streams, self._reading = source, streams, reading
        self._turns = {} if array is None else samples.turns_of(array.mounting)
        self._other_frames = () if array is None else streams.other_frames(array.mounting)
        self.intakes = streams.intakes(reading, array)
        self._missing, self._run, self._averaged = Missing(), Run(), AveragedRates()
        self._first_ns: int | None = None
        # more messages than come within the patience
        self._synchroniser = BatchSynchroniser(
            streams.layout,
            round(reading.tolerance_s * 1e9),
            patience_ns=PATIENCE_NS,
            hold_patience_ns=PATIENCE_NS,
            scalar_is_held=streams.scalar_is_held,
            expected=streams.layout.channels,
            capacity=1 << 24,
            delay_s=None if array is None else array.stamp_delay_s,
        )

    def pieces(self, progress: samples.Progress) -> Iterator[samples.Samples]:
        """Yield the samples in the order of time, the last piece with the usage of all.

        A channel without a value in a complete piece is None in that piece. Steps and losses are logged at the end.

        Raises
        ------
        InputError
            When no sample can be joined, or too many readings are missing.
        Refused
            When most messages of a sensor cannot be used.
        """
        end = np.empty(0, dtype=np.int64), np.empty((0, 0))
        for piece, _ in pairwise(chain(self._rows(progress), [end])):  # each waits for the next: the last tells all
            yield self._samples(*piece)

    def whole(self, progress: samples.Progress) -> samples.Samples:
        """Return the samples of the complete recording, as `pieces` yields them."""
        stamps_ns, rows = zip(*self._rows(progress), strict=True)
        return self._samples(np.concatenate(stamps_ns), np.concatenate(rows))

    def _rows(self, progress: samples.Progress) -> Iterator[tuple[IntArray, FloatArray]]:
        """Yield the stamps and the rows of samples, batch by batch."""
        is_reported = self.streams.clock == "stamp"
        for batch in self.source.batches(self.streams.wanted, self.streams.clock, progress):
            is_reported = is_reported or self._report_jitter(batch)
            usable = {name: self._usable(name, messages) for name, messages in batch.items()}
            yield from self._timed(*self._synchroniser.push_batch(usable))
        self.streams.require_half(self._missing, self._reading)
        yield from self._timed(*self._synchroniser.flush_batch())
        self._require_samples()
        self._report()

    def _require_samples(self) -> None:
        synchroniser = self._synchroniser
        if synchroniser.delivered or (self._reading.with_partial and synchroniser.partial):
            return
        if synchroniser.lost:
            raise Refused(f"no sample could be joined: {'; '.join(synchroniser.lost)}; look at the driver")
        raise InputError(
            f"no sample could be joined by the stamps of the topics ({synchroniser.explain_losses()}): "
            "compare the stamps: do the drivers share one clock?"
        )

    def _report_jitter(self, batch: Mapping[str, samples.StreamMessages]) -> bool:
        """Warn that times are those of the recorder, and of how even they are; return whether that was possible."""
        first = batch.get(sensor_stream(1))
        if first is None or first.stamps_ns is None or len(first.stamps_ns) < 3:
            return False
        intervals_ms = np.diff(first.stamps_ns) / 1e6
        log.warning(
            "the messages have no stamps, or the map says time: received, so that the recorder's times are taken; "
            f"their intervals vary by {np.std(intervals_ms):.2g} ms (standard deviation) about "
            f"{np.median(intervals_ms):.4g} ms"
        )
        return True

    def _report(self) -> None:
        """Log the steps of clocks, and what was lost."""
        synchroniser = self._synchroniser
        for step in synchroniser.steps:
            log.warning(step.sentence)
        if any(losses.dropped or losses.missing or losses.unusable for losses in synchroniser.losses.values()):
            log.warning(synchroniser.explain_losses())

    def _usable(self, stream: str, messages: samples.StreamMessages) -> samples.StreamMessages:
        """Return the messages of a stream that have a time within the window and values, in SI and in the array's axes.

        The others count as unusable, as in the collector.
        """
        messages = self._within(stream, messages)
        if not len(messages.order):
            return messages
        values, codes = self.intakes[stream].take(messages.values)
        stamps = messages.stamps_ns
        self._missing.add(stream, codes, None if stamps is None else (stamps - (self._first_ns or 0)) / 1e9)
        is_unusable = (np.abs(values) > largest_of(stream)).any(axis=1) | (codes > 0)
        if not is_channel(stream):
            is_unusable |= np.isnan(values).any(axis=1)
        if stamps is not None:
            is_unusable |= stamps == NO_TIME
        usable = replace(messages, values=values)
        if is_unusable.any():
            for code, count in enumerate(np.bincount(codes[is_unusable]).tolist()):
                self._synchroniser.refuse(stream, count, code)
            usable = usable.take(~is_unusable)
        usable = usable.turned(self._turns[stream]) if stream in self._turns else usable
        if stream == "gyroscope":
            self._averaged.add(usable.stamps_ns, usable.values)
        return usable

    def _within(self, stream: str, messages: samples.StreamMessages) -> samples.StreamMessages:
        """Return the messages within the part of the recording that is read."""
        stamps = messages.stamps_ns
        if stamps is None or not len(stamps):
            return messages
        if self._first_ns is None and not is_channel(stream):
            self._first_ns = int(stamps[0])
        inside = self._reading.window.contains(stamps, self._first_ns if self._first_ns is not None else int(stamps[0]))
        return messages if inside.all() else messages.take(inside)

    def _timed(self, stamps_ns: IntArray, values: FloatArray) -> Iterator[tuple[IntArray, FloatArray]]:
        """Yield stamps and rows of the samples that are wanted, none if empty: the complete ones, or all.

        Rows begin with the time in the run: the stamp, without the steps back.

        Raises
        ------
        InputError
            When the first sample comes again.
        """
        synchroniser, run, last = self._synchroniser, self._run, 3 * self._synchroniser.sensor_count
        if synchroniser.partial and not self._reading.with_partial:
            is_complete = np.isfinite(values[:, :last]).all(axis=1)
            stamps_ns, values = stamps_ns[is_complete], values[is_complete]
        if not len(stamps_ns):
            return
        if "gyroscope" in self.streams.wanted:
            first = self.streams.layout.columns.index(RATE_COLUMNS[0]) - 1
            values[:, first : first + 3] = self._averaged.means(stamps_ns, values[:, first : first + 3])
        times_ns, count = stamps_ns.copy(), len(stamps_ns)
        # As long as stamps rise the run needs to know its first sample, and the newest two.
        for index in range(count) if synchroniser.restarts else sorted({0, max(count - 2, 0), count - 1}):
            stamp_ns = int(stamps_ns[index])
            if run.begins_again(stamp_ns, values[index, :last].tobytes()):
                raise InputError(
                    "the stamps go backwards: keep one run (a bag that was played in a loop, or a sensor that "
                    "restarted, makes several)"
                )
            times_ns[index] = run.time_ns(stamp_ns)
        yield stamps_ns, np.column_stack([samples.seconds_of(times_ns), values])

    def _samples(self, stamps_ns: IntArray, rows: FloatArray) -> samples.Samples:
        missing, unfinished = self._missing.sentences(), self.source.unfinished
        joined = self._synchroniser.usage
        usage = replace(joined, unfinished=unfinished, missing=missing, other_frames=self._other_frames)
        return replace(samples_of(self.streams.layout, rows), stamps_ns=stamps_ns, usage=usage)


def samples_of(layout: SampleLayout, rows: FloatArray) -> samples.Samples:
    """Return the samples of rows (N, columns of the layout), those without all sensors with what they lack."""
    last = 1 + 3 * layout.sensor_count
    readings = rows[:, 1:last].reshape(-1, layout.sensor_count, 3)
    codes = missing_codes(readings)
    if not codes.any():
        return samples.Samples(layout.recording(rows))
    filled = np.where(np.isnan(readings), np.nanmean(readings, axis=1, keepdims=True), readings)
    rows[:, 1:last] = filled.reshape(-1, last - 1)
    return samples.Samples(layout.recording(rows), missing=codes)
