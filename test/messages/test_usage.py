"""The usage: how many of sensor 1's samples were used, why not the others, and when that is too few."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.core.interpolation import interpolated
from tam_calibration.messages.batch_synchroniser import BatchSynchroniser
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.samples import Samples, StreamMessages, Usage
from tam_calibration.messages.synchroniser import Synchroniser
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.recordings.fit_input import RecordingStream

MS = 1_000_000
PERIOD = 10 * MS
START = 10**18


def usage_of(messages, sensor_count=2, tolerance_ns=MS):
    """Return the usage of (stream, stamp) messages of sensors."""
    synchroniser = Synchroniser(SampleLayout(sensor_count), tolerance_ns)
    for stream, stamp_ns in messages:
        synchroniser.push(stream, stamp_ns, (0.0, 0.0, 0.0))
    return synchroniser.usage


def pairs(count, late_ns=0, lost=()):
    """Return messages of two sensors, the second with other stamps or missing."""
    messages = []
    for index in range(count):
        messages.append(("tam_1", START + index * PERIOD))
        if index not in lost:
            messages.append(("tam_2", START + index * PERIOD + late_ns))
    return messages


def test_all_samples_are_used():
    """Nothing is missing, nothing is told; what waits for its partners does not count."""
    assert usage_of(pairs(100)) == Usage(100, 100, (), (100, 100), (0, 0))
    assert usage_of([*pairs(100), ("tam_1", START + 100 * PERIOD)]) == Usage(100, 100, (), (101, 100), (0, 0))
    assert str(Usage(100, 100)) == "100 of 100 samples of sensor 1 used"
    assert Usage(100, 100).warnings() == Usage(0, 0).warnings() == ()


@pytest.mark.parametrize(
    ("late_s", "told"),
    [
        (-1, "none of tam_2, whose newest stamp is 1 s behind that of tam_1"),
        (1, "none of tam_2, whose newest stamp is 1 s ahead of that of tam_1"),
    ],
)
def test_clocks_that_differ_are_refused_with_the_parameter(late_s, told):
    """A sensor that lags by more than the patience, also where it is another that runs ahead."""
    messages = [message for message in pairs(200, late_ns=late_s * 1000 * MS) for message in around(message)]
    used = r"only \d+ of \d+ samples of sensor 1 used: \d+ found"
    with pytest.raises(Refused, match=rf"{used} {told}: (it|that) stopped, .* delay_s in the array file"):
        usage_of(messages, 3).require_enough()


def around(message):
    """Return a message, and for one of sensor 1 that of sensor 3, which comes a little later."""
    name, stamp_ns = message
    return [message, ("tam_3", stamp_ns)] if name == "tam_1" else [message]


@pytest.mark.parametrize(("lost", "warns"), [(9, False), (20, True)])
def test_gaps_are_a_warning_below_nine_tenths(lost, warns):
    """A tenth may be lost without a warning; the count and the sensor are told always."""
    usage = usage_of(pairs(100, lost=range(10, 10 + lost)))
    assert (usage.used, usage.received) == (100 - lost, 100)
    reason = f"{lost} found none of tam_2, of which {100 - lost} messages came: they have gaps, or come too late"
    assert str(usage) == f"{100 - lost} of 100 samples of sensor 1 used: {reason}; look at the load"
    assert usage.warnings() == ((f"only {usage}",) if warns else ())


def test_a_silent_sensor_is_named():
    """Of three sensors the third never sends: it is the cause, not the second."""
    messages = [(f"tam_{sensor}", index * PERIOD) for index in range(100) for sensor in (1, 2)]
    with pytest.raises(
        Refused, match="used: nothing arrived from tam_3: check sensor, cable, driver and topic; correct"
    ):
        usage_of(messages, 3).require_enough()


def test_false_stamps_are_named():
    """Of sensor 1 as its own fault; another sensor is interpolated over its own."""

    def false(sensor):
        return [(name, 0 if name == sensor and stamp % (3 * PERIOD) == 0 else stamp) for name, stamp in pairs(100)]

    (warning,) = usage_of(false("tam_1")).warnings()
    assert warning == "only 67 of 100 samples of sensor 1 used: 33 have false stamps: look at the driver of tam_1"
    assert usage_of(false("tam_2")).used > 95


def test_a_sensor_of_unusable_messages_is_named():
    """The counts say what is wrong with them."""
    synchroniser = Synchroniser(SampleLayout(2), MS)
    for name, stamp_ns in pairs(100):
        if name == "tam_1":
            synchroniser.push(name, stamp_ns, (0.0, 0.0, 0.0))
        else:
            synchroniser.refuse(name)
    with pytest.raises(
        Refused, match=r"found none of tam_2, most of whose messages cannot be used: .*100 messages unus"
    ):
        synchroniser.usage.require_enough()


def with_channel(name, layout, channel_stamps):
    """Return the usage of two sensors and a channel beside them."""
    synchroniser = Synchroniser(layout, MS)
    for stream, stamp_ns in pairs(100):
        synchroniser.push(stream, stamp_ns, (0.0, 0.0, 0.0))
    for stamp_ns in channel_stamps:
        synchroniser.push(name, stamp_ns, (20.0,))
    return synchroniser


def test_a_scalar_without_stamps_is_refused():
    """The scale would be another one without it; nothing else tells that it was lost."""
    usage = with_channel("scalar", SampleLayout(2, ("scalar",)), [0] * 100).usage
    with pytest.raises(
        Refused, match="of 100 messages of scalar 99 repeat the stamp before: all its stamps are zero: correct that"
    ):
        usage.require_enough()


def test_a_temperature_without_values_is_a_warning():
    """No fit needs it; half of it may be lost."""
    layout = SampleLayout(2, ("temperature",))
    stamps = [START + index * PERIOD for index in range(50)]
    synchroniser = with_channel("temperature", layout, stamps)
    synchroniser.refuse("temperature", 50)
    assert synchroniser.usage.warnings() == ()
    synchroniser.refuse("temperature", 1)
    assert synchroniser.usage.warnings() == (
        "of 101 messages of temperature 51 are damaged, not finite or without time",
    )


def test_sensors_that_are_lost_are_named():
    """Where no sample is made there is nothing else to tell."""
    zero = [(name, 0 if name == "tam_2" else stamp_ns) for name, stamp_ns in pairs(100)]
    synchroniser = Synchroniser(SampleLayout(2), MS)
    for stream, stamp_ns in zero:
        synchroniser.push(stream, stamp_ns, (0.0, 0.0, 0.0))
    assert synchroniser.lost == ["of 100 messages of tam_2 99 repeat the stamp before: all its stamps are zero"]


def test_a_usage_goes_to_other_processes():
    """As text, without a loss."""
    usage = usage_of(pairs(100, late_ns=3 * MS))
    usage = replace(usage, reasons=("one", "zwölf"), lost=("scalar",), scalar_is_lost=True)
    again = Usage.from_json(usage.to_json())
    assert again == usage
    np.testing.assert_array_equal(again.correlation, usage.correlation)


@pytest.mark.parametrize("newer", [{"kept": 3}, {"stages": [1, 2], "about": {"a": None}}, {"version": "9"}])
def test_keys_of_another_version_are_left_out(newer):
    """What both versions know is read; an older one lacks keys that may be left out."""
    usage = Usage(5, 7, ("one",))
    assert Usage.from_json(json.dumps(json.loads(usage.to_json()) | newer)) == usage
    assert Usage.from_json('{"used": 5, "received": 7, "reasons": ["one"]}') == usage


@pytest.mark.parametrize(
    "text",
    ["", "not ready", "[]", "3", "{}", '"used received"', '{"used": 5}', '{"used": "5", "received": 7}']
    + [f'{{"used": 5, "received": 7, {more}}}' for more in ('"reasons": {}', '"lost": [1]', '"readings": [null]')],
)
def test_what_is_no_usage_is_told_in_a_sentence(text):
    """As of a version whose keys mean something else."""
    with pytest.raises(InputError, match="the collector is of another version than the calibrator: start both"):
        Usage.from_json(text)


def test_what_is_interpolated_is_counted():
    """Four readings of sensor 2 come before the first value between two of them."""
    assert usage_of(pairs(100, late_ns=3 * MS)).interpolated == (0, 96)


def turning(count, rate_deg_per_s, scalar_every=None):
    """Return samples at 100 Hz of two sensors that turn steadily in 50 µT, some with a scalar reading."""
    time_s = 0.01 * np.arange(count)
    angle = np.radians(rate_deg_per_s) * time_s
    field_T = 50e-6 * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    scalar_T = None if scalar_every is None else np.where(np.arange(count) % scalar_every == 1, 50e-6, np.nan)
    return Recording(time_s, np.stack([field_T, field_T], axis=1), scalar_T)


@pytest.mark.parametrize(("rate_deg_per_s", "is_told"), [(30, False), (180, True)])
def test_interpolation_that_is_worse_than_the_standard_errors_is_told(rate_deg_per_s, is_told):
    """At 25 Hz a turn of 180°/s leaves 0.6 nT, which the noise of 1 nT of 250 readings does not hide."""
    usage = Usage(1000, 1000, (), (1000, 250), (0, 990))
    seen = usage.with_each_reading_once(turning(1000, rate_deg_per_s))
    warnings = usage.interpolation_warnings(seen, np.array([1e-9, 1e-9]))
    assert [warning[:68] for warning in warnings] == [
        "sensor 2 is read at 25 Hz while the array turns at up to 180°/s: its"
    ] * is_told
    assert all("are wrong by 0.61 nT (RMS)" in warning for warning in warnings)
    for part, is_hidden in ((1.4, True), (1.6, False)):  # of the noise of the mean
        noise_T = np.array([1e-9, 0.049 * np.radians(180 * 0.04) ** 4 * 50e-6 * np.sqrt(250) / part])
        fast = usage.with_each_reading_once(turning(1000, 180))
        assert (usage.interpolation_warnings(fast, noise_T) == ()) == is_hidden
    assert Usage(1000, 1000, (), (1000, 1000), (0, 0)).interpolation_warnings(turning(1000, 720), np.zeros(2)) == ()


def on_disk(recording):
    """Return the samples as those of a recording that is larger than memory."""
    return RecordingStream([Samples(recording.take(slice(0, 600))), Samples(recording.take(slice(600, None)))])


@pytest.mark.parametrize("kept", [lambda recording: recording, on_disk], ids=["in memory", "on disk"])
def test_readings_of_a_slow_sensor_count_once_in_a_fit(kept):
    """Of a sensor at half the rate every second sample is left, and each with a scalar reading, none beside these."""
    usage = Usage(1000, 1000, (), (1000, 500), (0, 990))
    assert usage.with_each_reading_once(kept(turning(1000, 30))).sample_count == 500
    with_scalar = usage.with_each_reading_once(kept(turning(1000, 30, scalar_every=10))).whole()
    assert with_scalar.scalar_count == 100
    assert np.diff(with_scalar.time_s).min() > 0.015
    often = turning(1000, 30)
    with_scalar = usage.with_each_reading_once(kept(replace(often, scalar_T=often.readings_T[:, 0, 0] + 60e-6)))
    assert with_scalar.sample_count == with_scalar.scalar_count == 500
    samples = kept(turning(1000, 30))
    assert Usage(1000, 1000, (), (1000, 500), (0, 0)).with_each_reading_once(samples) is samples
    assert Usage(1000, 1000, (), (1000, 950), (0, 990)).with_each_reading_once(samples).sample_count == 1000


def test_the_samples_that_are_kept_hold_readings_as_they_came():
    """Where a sensor at half the rate reads with every second sample of sensor 1, its noise is as white as it was."""
    stamps = [START + index * PERIOD for index in range(1000)]
    messages = [(name, stamp) for index, stamp in enumerate(stamps) for name in ("tam_1", "tam_2")[: 2 - index % 2]]
    usage = usage_of(messages)
    assert usage.interpolated[1] == pytest.approx(498, abs=3)
    times = np.array([0, 2, 4, *range(6, 1000)])  # before four readings nothing lies between two
    once = usage.with_each_reading_once(turning(1000, 30).take(times))
    assert np.isin(np.rint(100 * once.time_s) % 2, 0).all() and once.sample_count == 500
    assert np.abs(once.interpolated_noise.correlation).max() < 0.01


@pytest.mark.parametrize(
    ("kept", "every", "late"),
    [
        *((lambda recording: recording, *each) for each in ((1.0, 0.9), (1.0003, 0.3), (0.49, 0.2))),
        (on_disk, 1.97, 0.4),
    ],
)
def test_the_correlation_of_interpolated_noise_is_told(kept, every, late):
    """White noise that is read every so many samples, and so late: its values at the samples are alike as is said."""
    random, count = np.random.default_rng(1), 8000
    at_ns = np.arange(0, count * PERIOD, PERIOD)
    read_ns = np.arange(late * PERIOD, count * PERIOD, every * PERIOD).astype(np.int64)
    noise = random.normal(size=(len(read_ns), 100))
    streams = [("tam_1", stamp) for stamp in at_ns] + [("tam_2", stamp) for stamp in read_ns]
    usage = usage_of([(name, START + int(stamp)) for name, stamp in sorted(streams, key=lambda one: one[1])], 2, 0)
    values = interpolated(read_ns, noise, at_ns)[0]
    known = np.isfinite(values).all(axis=1)
    samples = usage.with_each_reading_once(kept(turning(count, 30).take(known)))
    values = values[np.isin(at_ns / 1e9, np.round(samples.whole().time_s, 9))]
    for lag in (1, 2, 3, 4):
        seen = np.mean(values[lag:] * values[:-lag])
        assert samples.whole().interpolated_noise.correlation[1, lag - 1] == pytest.approx(seen, abs=0.02)
    assert not samples.whole().interpolated_noise.correlation[0].any()


@pytest.mark.parametrize("in_batches", [False, True])
@pytest.mark.parametrize(("other", "is_doubled"), [(0.0, False), (1e-6, True)])
def test_two_publishers_with_equal_stamps_are_refused(other, is_doubled, in_batches):
    """Messages that repeat a stamp with other values are another publisher's; a message that comes twice is none."""
    stamps = START + PERIOD * np.arange(50)
    synchroniser = BatchSynchroniser(SampleLayout(2), MS)
    values = np.full((50, 3), 1e-5)
    doubled = np.repeat(values, 2, axis=0) + np.outer(np.tile([0.0, other], 50), np.ones(3))
    streams = {"tam_1": (stamps, 3 * np.arange(50), values)}
    streams["tam_2"] = np.repeat(stamps, 2), np.sort([*(3 * np.arange(50) + 1), *(3 * np.arange(50) + 2)]), doubled
    batch = {name: StreamMessages(order, own, rows) for name, (own, order, rows) in streams.items()}
    if in_batches:
        synchroniser.push_batch(batch)
    else:
        synchroniser._push_each(batch)
    usage = synchroniser.usage
    assert bool(usage.doubled) is is_doubled
    if is_doubled:
        with pytest.raises(Refused, match="50 of 100 messages of tam_2 repeat the stamp before with other values"):
            usage.require_enough()
