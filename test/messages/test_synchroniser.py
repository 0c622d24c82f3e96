"""The synchroniser: what it joins, what it loses and says, and that it does not depend on the order of arrival."""

import math
from random import Random

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tam_calibration.core.interpolation import LARGEST_ERROR
from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.synchroniser import REMEMBERED, Sample, Synchroniser
from tam_calibration.messages.timeline import StampStep

MS = 1_000_000
PERIOD = 10 * MS
START = 1_700_000_000_000 * MS
CROSS = SampleLayout(4, ("scalar",))
ALL = SampleLayout(2, ("scalar", "temperature", "current", "attitude"))


def message(stream, stamp_ns):
    """Make a message whose values tell its stream and stamp."""
    width = {"scalar": 1, "temperature": 1, "current": 1, "attitude": 4}.get(stream, 3)
    return stream, stamp_ns, (stamp_ns / 1e9,) * width


def push_all(synchroniser, messages):
    """Return the samples of messages pushed one by one, and of the flush."""
    samples = [sample for one in messages for sample in synchroniser.push(*one)]
    return samples + synchroniser.flush()


def steady(layout, count, streams=None, start=0):
    """Make the messages of all streams at common stamps."""
    names = streams or [*(f"tam_{k + 1}" for k in range(layout.sensor_count)), *layout.channels]
    return [message(name, start + index * PERIOD) for index in range(count) for name in names]


def test_a_sample_is_complete_with_its_last_message():
    """With equal stamps and the scalar last, each sample comes out at once, in stamp order, none lost."""
    synchroniser = Synchroniser(CROSS, MS, expected=["scalar"])
    counts = [len(synchroniser.push(*one)) for one in steady(CROSS, 50)]
    assert counts == [0, 0, 0, 0, 1] * 50
    assert synchroniser.explain_losses() == "50 of 50 samples synchronised"
    assert not synchroniser.drops_everything


def test_values_are_in_the_order_of_the_layout():
    """Readings of sensors 1 to K come first, then scalar, temperature, current and attitude."""
    synchroniser = Synchroniser(ALL, MS, expected=ALL.channels, hold_patience_ns=MS)
    streams = {"tam_1": (1.0, 2.0, 3.0), "tam_2": (4.0, 5.0, 6.0), "scalar": (7.0,), "temperature": (8.0,)}
    streams |= {"current": (9.0,), "attitude": (10.0, 11.0, 12.0, 13.0)}
    samples = push_all(synchroniser, [(name, 5, values) for name, values in reversed(streams.items())])
    assert samples == [Sample(5, 0, tuple(float(value) for value in range(1, 14)))]


def test_the_nearest_message_within_the_tolerance_is_taken():
    """Of several messages within the tolerance the nearest joins; without one, a sample is lost and counted."""
    synchroniser = Synchroniser(SampleLayout(2), 2 * MS)
    messages = [message("tam_1", 10 * MS), *(message("tam_2", stamp) for stamp in (8 * MS, 9 * MS, 12 * MS, 17 * MS))]
    samples = push_all(synchroniser, [*messages, message("tam_1", 20 * MS)])
    assert [sample.values[3] for sample in samples] == [0.009]
    assert synchroniser.losses["tam_2"].missing == 1
    assert synchroniser.losses["tam_1"].unmatched == 1


def test_a_scalar_that_arrives_later_is_waited_for():
    """A scalar whose topic lags by less than the patience is not lost; each sample keeps its own."""
    synchroniser = Synchroniser(SampleLayout(1, ("scalar",)), MS, patience_ns=50 * MS, expected=["scalar"])
    lagging = sorted(steady(SampleLayout(1, ("scalar",)), 30), key=lambda one: one[1] + 45 * MS * (one[0] == "scalar"))
    samples = push_all(synchroniser, lagging)
    assert [sample.values[3] for sample in samples] == [sample.stamp_ns / 1e9 for sample in samples]
    assert len(samples) == 30


def test_a_scalar_that_never_comes_delays_by_no_more_than_the_patience():
    """Samples without scalar come out with NaN when the sensors have run ahead by the patience."""
    synchroniser = Synchroniser(SampleLayout(1, ("scalar",)), MS, patience_ns=50 * MS, expected=["scalar"])
    out = [synchroniser.push(*message("tam_1", index * PERIOD)) for index in range(20)]
    assert [len(samples) for samples in out] == [0] * 5 + [1] * 15
    assert math.isnan(out[-1][0].values[3])
    assert synchroniser.losses["scalar"].missing == 15


def test_a_channel_that_was_not_seen_is_not_waited_for():
    """Without expectation a silent channel costs no delay."""
    synchroniser = Synchroniser(SampleLayout(1, ("scalar", "temperature")), MS)
    assert len(synchroniser.push(*message("tam_1", 0))) == 1


def test_held_channels_have_their_newest_value_and_a_maximum_age():
    """A held value is the newest at or before the sample, and NaN when older than its maximum age."""
    synchroniser = Synchroniser(SampleLayout(1, ("current",)), MS)
    messages = [message("tam_1", 0), message("current", 9 * MS), message("current", 11 * MS)]
    messages += [message("tam_1", index * PERIOD) for index in range(1, 205)]
    values = [sample.values[3] for sample in push_all(synchroniser, messages)]
    assert values[1:202] == [0.009] + [0.011] * 200  # for two seconds
    assert math.isnan(values[0]) and np.isnan(values[202:]).all()


def test_a_scalar_without_stamp_joins_the_next_sample_alone():
    """Of messages that come between two samples the newest two join the next two, and no message joins twice."""
    synchroniser = Synchroniser(SampleLayout(1, ("scalar",)), MS, scalar_is_held=True)
    samples = synchroniser.push(*message("tam_1", 7))
    for value in (1.0, 2.0, 3.0):
        synchroniser.push("scalar", None, (value,))
    for stamp in (8, 9, 10):
        samples += synchroniser.push(*message("tam_1", stamp))
    np.testing.assert_array_equal([sample.values[3] for sample in samples], [np.nan, 2.0, 3.0, np.nan])


@pytest.mark.parametrize("hold_patience_ns", [0, 10 * PERIOD])
def test_nothing_is_lost_of_a_scalar_without_stamps(hold_patience_ns):
    """At the rate of the sensors, before or after them by chance, each sample has a value of its own."""
    random = Random(1)
    synchroniser = Synchroniser(
        SampleLayout(1, ("scalar",)),
        hold_patience_ns=hold_patience_ns,
        scalar_is_held=True,
        expected=["scalar"] * (hold_patience_ns > 0),
    )
    samples = []
    for index in range(1000):
        both = [("tam_1", index * PERIOD, (0.0, 0.0, 0.0)), ("scalar", None, (float(index),))]
        for one in random.sample(both, 2):
            samples += synchroniser.push(*one)
    values = [sample.values[3] for sample in samples + synchroniser.flush()]
    assert len(values) == 1000 and sum(map(math.isnan, values)) <= 1
    known = [value for value in values if not math.isnan(value)]
    assert known == sorted(set(known))


def test_duplicate_and_late_stamps_are_counted_and_dropped():
    """A repeated stamp and a small step back are not delivered, and said."""
    synchroniser = Synchroniser(SampleLayout(1), MS)
    samples = push_all(synchroniser, [message("tam_1", stamp * MS) for stamp in (0, 10, 10, 5, 20)])
    assert [sample.stamp_ns for sample in samples] == [0, 10 * MS, 20 * MS]
    assert synchroniser.explain_losses() == (
        "3 of 5 samples synchronised; tam_1: 1 repeated stamps, 1 stamps out of order"
    )


def test_a_looping_bag_begins_a_new_epoch_without_loss():
    """Stamps that step back begin a new epoch; every sample of both rounds is delivered in order."""
    synchroniser = Synchroniser(CROSS, MS, expected=["scalar"])
    samples = push_all(synchroniser, steady(CROSS, 100) * 3)
    assert [(sample.epoch, sample.stamp_ns) for sample in samples] == [
        (e, i * PERIOD) for e in range(3) for i in range(100)
    ]
    assert synchroniser.restarts == 2


YEAR = 365 * 86_400_000 * MS
FALSE = {"zero": -START, "a year ahead": YEAR, "1 s back": -1000 * MS, "1 s ahead": 1000 * MS}
"""By how much a stamp may be false."""


@pytest.mark.parametrize("patience_ns", [50 * MS, 5000 * MS])
@pytest.mark.parametrize("streams", [["tam_1"], ["tam_2"], ["scalar"], ["tam_1", "tam_2", "tam_3", "tam_4", "scalar"]])
@pytest.mark.parametrize("error_ns", FALSE.values(), ids=FALSE)
def test_a_false_stamp_costs_one_sample(error_ns, streams, patience_ns):
    """However late it is judged, no other sample is lost, of sensors but the first none at all, and no step is told."""
    synchroniser = Synchroniser(CROSS, MS, patience_ns, expected=["scalar"])
    messages = steady(CROSS, 400, start=START)
    for place, (name, stamp_ns, values) in enumerate(messages):
        if name in streams and stamp_ns == START + 100 * PERIOD:
            messages[place] = (name, stamp_ns + error_ns, values)
    samples = push_all(synchroniser, messages)
    expected = [START + index * PERIOD for index in range(400) if index != 100 or "tam_1" not in streams]
    assert [sample.stamp_ns for sample in samples] == expected
    assert sum(math.isnan(sample.values[-1]) for sample in samples) == (streams == ["scalar"])
    assert [synchroniser.losses[name].implausible for name in streams] == [1] * len(streams)
    assert (synchroniser.restarts, synchroniser.steps) == (0, [])
    assert "tam_1: " in synchroniser.explain_losses() or "tam_1" not in streams


@pytest.mark.parametrize("patience_ns", [50 * MS, 5000 * MS])
@pytest.mark.parametrize("step_ns", [-300 * MS, 300 * MS, -3000 * MS, YEAR])
def test_a_step_of_the_clock_costs_no_sample(step_ns, patience_ns):
    """When all stamps step every sample is delivered in its order, and the step is told once with its size."""
    synchroniser = Synchroniser(CROSS, MS, patience_ns, expected=["scalar"])
    messages = steady(CROSS, 1000, start=START) + steady(CROSS, 500, start=START + 1000 * PERIOD + step_ns)
    samples = push_all(synchroniser, messages)
    expected = [START + index * PERIOD + step_ns * (index >= 1000) for index in range(1500)]
    assert [sample.stamp_ns for sample in samples] == expected
    assert not any(losses.dropped or losses.missing for losses in synchroniser.losses.values())
    assert synchroniser.steps == [StampStep("tam_1", step_ns)]
    assert synchroniser.restarts == (step_ns < 0)


@pytest.mark.parametrize("step_ns", [-300 * MS, 300 * MS])
def test_a_step_costs_interpolated_sensors_four_samples(step_ns):
    """Sensors that are read between those of the first need four readings before they tell of a sample again."""
    synchroniser = Synchroniser(SampleLayout(2), 0)
    stamps = [START + index * PERIOD + step_ns * (index >= 500) for index in range(1000)]
    shifted = [(name, stamp + late) for stamp in stamps for name, late in (("tam_1", 0), ("tam_2", 5 * MS))]
    samples = push_all(synchroniser, [message(*one) for one in shifted])
    assert [sample.stamp_ns for sample in samples] == [*stamps[4:500], *stamps[504:]]
    assert synchroniser.steps == [StampStep("tam_1", step_ns)]


@pytest.mark.parametrize("gap_ns", [0, 1000 * MS, 4000 * MS])
def test_a_pause_of_all_streams_is_no_step_of_the_clock(gap_ns):
    """Stamps that go on as late as their messages arrive are right; a clock that is set goes on at once."""
    synchroniser = Synchroniser(SampleLayout(2), MS)
    for name, stamp_ns, values in steady(SampleLayout(2), 1000, start=START):
        paused_ns = (stamp_ns >= START + 500 * PERIOD) * 1000 * MS
        arrived_ns = stamp_ns + MS + (paused_ns and gap_ns)
        synchroniser.push(name, stamp_ns + paused_ns, values, arrived_ns)
    assert synchroniser.steps == [StampStep("tam_1", 1000 * MS, gap_ns > 0)]
    told = "no messages of tam_1 for 1.0 s" if gap_ns else "the stamps of tam_1 stepped ahead by 1 s: a clock was set"
    assert synchroniser.steps[0].sentence.startswith(told)


def test_a_step_is_told_in_words():
    """With stream, direction and size."""
    assert str(StampStep("tam_1", -300 * MS)) == "the stamps of tam_1 stepped back by 0.3 s"
    assert str(StampStep("scalar", 5)) == "the stamps of scalar stepped ahead by 5e-09 s"


def test_a_pause_of_one_stream_is_no_step():
    """A sensor that was silent for seconds goes on at once where the others are."""
    synchroniser = Synchroniser(SampleLayout(2), MS)
    messages = steady(SampleLayout(2), 1000)
    kept = [one for one in messages if one[0] == "tam_1" or not 3000 * MS <= one[1] < 7000 * MS]
    assert len(push_all(synchroniser, kept)) == 600
    assert synchroniser.steps == [] and synchroniser.losses["tam_2"].dropped == 0


def test_a_slow_stream_is_not_doubted():
    """Streams of one message in a second are joined without delay once their period is known."""
    synchroniser = Synchroniser(SampleLayout(1), MS)
    counts = [len(synchroniser.push(*message("tam_1", index * 1000 * MS))) for index in range(10)]
    assert counts == [1] * 10


@pytest.mark.parametrize("stopped", ["tam_1", "tam_3", "scalar"])
def test_a_stream_that_stops_bounds_memory_and_is_reported(stopped):
    """What waits for a stream that stopped is let go after the patience; samples go on, and a sensor is said."""
    synchroniser = Synchroniser(CROSS, MS, patience_ns=100 * MS)
    messages = steady(CROSS, 100) + [one for one in steady(CROSS, 1000, start=100 * PERIOD) if one[0] != stopped]
    reported = set()
    for one in messages:
        synchroniser.push(*one)
        reported |= {synchroniser.drops_everything}
    assert max(len(stream.buffer) for stream in synchroniser._streams.values()) <= 12
    assert reported == ({False} if stopped == "scalar" else {False, True})
    assert synchroniser.silent == [stopped] * (stopped != "scalar") and not synchroniser.drops_everything


def test_buffers_have_a_capacity():
    """However dense the stamps, no buffer grows past its capacity."""
    synchroniser = Synchroniser(SampleLayout(2), MS, capacity=100)
    for stamp in range(1000):
        synchroniser.push(*message("tam_2", stamp))
    assert len(synchroniser._streams["tam_2"].buffer) == 100
    assert synchroniser.losses["tam_2"].unmatched == 900


def test_a_silent_sensor_is_named():
    """When nothing is joined the explanation names the sensor that was never heard."""
    synchroniser = Synchroniser(SampleLayout(3), MS)
    push_all(synchroniser, steady(SampleLayout(3), 5, streams=["tam_1", "tam_3"]))
    assert "0 of 5 samples synchronised; nothing arrived from tam_2" in synchroniser.explain_losses()


def turning(time_s):
    """Return the reading of a sensor that turns at 180°/s in 50 µT."""
    angle = np.pi * np.asarray(time_s)
    return 50e-6 * np.stack([np.cos(angle), np.sin(angle) / 2, np.sin(angle) / 3], axis=-1)


def drivers(periods_s, offsets_s=(0, 0, 0, 0), jitter_s=0.0, span_s=12.0):
    """Make the messages of four drivers with clocks of their own, read at the times of their stamps, as they arrive."""
    random = np.random.default_rng(1)
    messages = []
    for sensor, (period, offset) in enumerate(zip(periods_s, offsets_s, strict=True), start=1):
        index = np.arange(round(span_s / period))
        stamps = np.round(1e9 * (period * index + offset + random.uniform(-jitter_s, jitter_s, len(index)))).astype(int)
        late = np.maximum.accumulate(stamps + random.integers(0, 3 * MS, len(stamps)))
        values = map(tuple, turning(stamps / 1e9).tolist())
        messages += zip(late.tolist(), [f"tam_{sensor}"] * len(index), stamps.tolist(), values, strict=True)
    return [tuple(one) for _, *one in sorted(messages, key=lambda one: one[0])]


@pytest.mark.parametrize(
    ("periods_s", "offsets_s", "jitter_s", "largest_nT"),
    [
        ((0.01,) * 4, (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 0.003),
        ((0.01, 0.01 * (1 + 1e-4), 0.01 * (1 - 1e-4), 0.01 * (1 + 2e-4)), (0, 0, 0, 0), 0.0, 0.003),
        ((0.01,) * 4, (0, 2.5e-3, 5e-3, 7.5e-3), 2e-3, 0.01),
        ((0.02,) * 4, (0, 5e-3, 10e-3, 15e-3), 0.0, 0.04),
        ((0.02, 0.01, 0.01, 0.01), (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 0.003),
        ((0.01, 0.02, 0.02, 0.02), (0, 2.5e-3, 5e-3, 7.5e-3), 0.0, 0.04),
    ],
    ids=["offsets", "free clocks", "jitter", "50 Hz", "slow sensor 1", "fast sensor 1"],
)
def test_sensors_with_clocks_of_their_own_are_brought_to_the_stamp_of_sensor_1(
    periods_s, offsets_s, jitter_s, largest_nT
):
    """99 % of sensor 1's samples are made, and the others read what they would have read at its stamp."""
    synchroniser = Synchroniser(SampleLayout(4), 0)
    samples = push_all(synchroniser, drivers(periods_s, offsets_s, jitter_s))
    assert len(samples) >= 0.99 * synchroniser.losses["tam_1"].received
    values = np.array([sample.values for sample in samples]).reshape(-1, 4, 3)
    error = values - turning([sample.stamp_ns / 1e9 for sample in samples])[:, None]
    assert 1e9 * np.abs(error).max() < largest_nT


def test_readings_of_one_stamp_stay_as_they_are():
    """To the last bit, and without waiting for what comes after."""
    messages = [("tam_1", 0, (0.1, 0.2, 0.3)), ("tam_2", 0, (0.7, 0.8, 0.9)), ("tam_3", 0, (1 / 3, 1 / 7, 1 / 9))]
    synchroniser = Synchroniser(SampleLayout(3), 0)
    samples = [sample for one in messages for sample in synchroniser.push(*one)]
    assert samples == [Sample(0, 0, tuple(value for _, _, values in messages for value in values))]


def test_a_sample_between_messages_waits_for_one_more():
    """Sensor 2 reads 5 ms after sensor 1: its message completes the sample of 5 ms before."""
    synchroniser = Synchroniser(SampleLayout(2), 0)
    counts = [
        len(synchroniser.push(*message(name, index * PERIOD + late)))
        for index in range(10)
        for name, late in (("tam_1", 0), ("tam_2", PERIOD // 2))
    ]
    assert counts == [0, 0] * 4 + [0, 1] * 6


def test_stated_delays_are_taken_off_the_stamps():
    """Stamps that are late by what is stated give the samples of true stamps; sensor 1's too."""
    late_ns = {"tam_1": 3 * MS, "tam_2": -4 * MS, "tam_3": 0, "tam_4": 12 * MS}
    true = drivers((0.01,) * 4, (0, 2.5e-3, 5e-3, 7.5e-3))
    late = [(name, stamp + late_ns[name], values) for name, stamp, values in true]
    delays = Synchroniser(SampleLayout(4), 0, delay_s=1e-9 * np.array(list(late_ns.values())))
    assert push_all(delays, late) == push_all(Synchroniser(SampleLayout(4), 0), true)


def test_a_stated_delay_of_the_scalar_is_taken_off_its_stamps():
    """Stamped three samples late at 10 Hz, its readings join the samples that they were taken with."""
    layout = SampleLayout(2, ("scalar",))
    true = [one for one in steady(layout, 200) if one[0] != "scalar" or one[1] % (10 * PERIOD) == 0]
    late = [(name, stamp + 30 * MS * (name == "scalar"), values) for name, stamp, values in true]
    late.sort(key=lambda one: one[1])
    delays = Synchroniser(layout, 0, expected=["scalar"], delay_s=np.array([0, 0, 30e-3]))
    assert push_all(delays, late) == push_all(Synchroniser(layout, 0, expected=["scalar"]), true)


def test_a_delay_reaches_no_further_back_than_the_start_of_a_clock():
    """At the start of a simulation a late sensor's first readings are of before time began: these are not used."""
    synchroniser = Synchroniser(SampleLayout(2), 0, delay_s=np.array([15e-3, 15e-3]))
    samples = push_all(synchroniser, steady(SampleLayout(2), 10))
    assert [sample.stamp_ns for sample in samples] == [5 * MS + index * PERIOD for index in range(8)]
    assert synchroniser.losses["tam_1"].unusable == 2


@pytest.mark.parametrize(("lost", "samples"), [(1, 60), (7, 60), (8, 52)])
def test_lost_messages_cost_no_sample_up_to_seven_in_a_row(lost, samples):
    """What sensor 2 did not send is told by what it sent before and after, unless that is too far apart."""
    synchroniser = Synchroniser(SampleLayout(2), 0)
    gone = {("tam_2", index * PERIOD) for index in range(20, 20 + lost)}
    messages = [one for one in steady(SampleLayout(2), 60) if one[:2] not in gone]
    assert len(push_all(synchroniser, messages)) == samples


def test_a_scalar_with_a_clock_of_its_own_joins_the_nearest_sample():
    """At 10 Hz and 3 ms off, each of its messages is part of one sample, once the interval of samples is known."""
    layout = SampleLayout(1, ("scalar",))
    messages = steady(layout, 200, streams=["tam_1"])
    messages += [message("scalar", 10 * index * PERIOD + 3 * MS) for index in range(20)]
    messages.sort(key=lambda one: one[1])
    samples = push_all(Synchroniser(layout, 0, expected=["scalar"]), messages)
    joined = [(sample.stamp_ns, sample.values[3]) for sample in samples if math.isfinite(sample.values[3])]
    assert joined == [(10 * index * PERIOD, (10 * index * PERIOD + 3 * MS) / 1e9) for index in range(2, 20)]


PATIENCE = 100 * MS


def rough_streams(random, layout):
    """Make streams with jitter, losses, duplicates, steps back and restarts; (time, message) for each stream."""
    streams = []
    names = [*(f"tam_{k + 1}" for k in range(layout.sensor_count)), *layout.channels]
    rounds = [random.randint(40, 80) for _ in range(random.choice((1, 1, 2, 3)))]
    for name in names:
        every = 1 if name.startswith("tam") else random.choice((1, 1, 3))
        clock, messages = 0, []
        for length in rounds:
            for index in range(0, length, every):
                stamp = index * PERIOD + random.choice((0, random.randint(0, 3 * MS)))
                fate = random.random()
                if fate > 0.05:
                    messages.append((clock + index * PERIOD, message(name, stamp)))
                if fate > 0.97:
                    messages.append((clock + index * PERIOD, message(name, stamp - random.choice((0, MS)))))
            clock += length * PERIOD
        streams.append(messages)
    return streams


def arrive(random, streams):
    """Interleave the streams with delays below half the patience; each keeps its own order."""
    arrivals = []
    for messages in streams:
        latest = 0
        for time, one in messages:
            latest = max(latest, time + random.randint(0, PATIENCE // 2 - 4 * MS))
            arrivals.append((latest, random.random(), one))
    in_order = {}
    for messages in streams:
        in_order[messages[0][1][0]] = iter([one for _, one in messages])
    return [next(in_order[one[0]]) for _, _, one in sorted(arrivals, key=lambda arrival: arrival[:2])]


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_samples_do_not_depend_on_the_interleaving(seed):
    """Streams with jitter, losses, repeats and restarts give the same samples and losses however they interleave."""
    random = Random(seed)
    streams = rough_streams(random, ALL)
    results = []
    for _ in range(3):
        synchroniser = Synchroniser(ALL, 2 * MS, PATIENCE, PATIENCE, expected=ALL.channels)
        samples = push_all(synchroniser, arrive(random, streams))
        results.append((repr(samples), synchroniser.losses, synchroniser.restarts))
        order = [(sample.epoch, sample.stamp_ns) for sample in samples]
        assert order == sorted(set(order))
    assert results[0] == results[1] == results[2]


@settings(max_examples=80, deadline=None)
@given(
    seed=st.integers(0, 2**32),
    tolerance_ns=st.integers(MS // 10, 40 * MS),
    loss=st.sampled_from([0.02, 0.1, 0.4]),
    jitter_ns=st.sampled_from([0, MS, PERIOD // 5]),
)
def test_a_loss_makes_no_stream_late(seed, tolerance_ns, loss, jitter_ns):
    """Whatever the tolerance and what is lost, a sample has the messages of its own period where they came."""
    random = Random(seed)
    layout = SampleLayout(3, ("scalar",))
    streams, came = [], {}
    for name in ("tam_1", "tam_2", "tam_3", "scalar"):
        kept = [index for index in range(120) if random.random() > loss]
        came[name] = set(kept)
        stamps = {index: index * PERIOD + random.randint(0, jitter_ns) for index in kept}
        width = 1 if name == "scalar" else 3
        streams.append([(stamp, (name, stamp, (float(index),) * width)) for index, stamp in stamps.items()])
    messages = arrive(random, streams)
    samples = push_all(Synchroniser(layout, tolerance_ns, PATIENCE, expected=["scalar"]), messages)
    for sample in samples:
        index = int(sample.values[0])
        for name, value in zip(("tam_2", "tam_3", "scalar"), sample.values[3::3], strict=True):
            if index in came[name] and jitter_ns <= tolerance_ns:
                assert value == index


def test_a_late_message_costs_no_delay():
    """A message less than half an interval later than sensor 1's completes its sample, once the interval is known."""
    synchroniser = Synchroniser(SampleLayout(2), 10 * PERIOD)
    counts = [
        len(synchroniser.push(*message(name, index * PERIOD + late)))
        for index in range(40)
        for name, late in (("tam_1", 0), ("tam_2", 4 * MS))
    ]
    assert counts[2 * REMEMBERED + 2 :] == [0, 1] * (39 - REMEMBERED)
    assert sum(counts) == 40


@pytest.mark.parametrize("seed", range(4))
def test_interpolated_values_hold_however_drivers_stall(seed):
    """Drivers that stop for a second and catch up, sensor 1 too: what joins is the field at the stamp, or nothing.

    A field that turns at 2 rad/s, read at 100 Hz: the interpolation's own error is 0.049 (ωh)⁴.
    """
    random, rate = Random(seed), 2.0
    arrivals = []
    for sensor, offset_ns in enumerate((0, 2_500_000, 5_000_000, 7_500_000)):
        stalls = [(random.uniform(0, 6e9), random.uniform(0, 1e9)) for _ in range(3)]
        for stamp_ns in range(offset_ns, offset_ns + 600 * PERIOD, PERIOD):
            arrival_ns = max(
                [stamp_ns, *(begin + length for begin, length in stalls if begin < stamp_ns < begin + length)]
            )
            arrivals.append((arrival_ns, stamp_ns, f"tam_{sensor + 1}"))
    messages = [
        (name, START + stamp_ns, (math.sin(rate * stamp_ns / 1e9),) * 3) for _, stamp_ns, name in sorted(arrivals)
    ]
    samples = push_all(Synchroniser(SampleLayout(4)), messages)
    assert 100 < len(samples) < 600
    for sample in samples:
        truth = math.sin(rate * (sample.stamp_ns - START) / 1e9)
        assert np.abs(np.array(sample.values) - truth).max() < LARGEST_ERROR * (rate * PERIOD / 1e9) ** 4


def stalled(names, first, last, chunk, burst_ns):
    """Return the messages of streams at 100 Hz, of which nothing arrives for a while, and then all in a burst.

    It takes so long, and holds so many messages of one stream, then as many of the next, and so on.
    """
    messages, latest = [], dict.fromkeys(names, 0)
    for index in range(last + 300):
        for place, name in enumerate(names):
            stamp = START + index * PERIOD
            arrived = stamp + MS
            if first <= index < last:
                part = (index - first) // chunk * len(names) + place
                arrived = START + last * PERIOD + part * burst_ns // (len(names) * (1 + (last - first) // chunk))
            latest[name] = max(latest[name], arrived)  # a stream keeps its order
            messages.append((*message(name, stamp), latest[name]))
    return sorted(messages, key=lambda one: one[3])


@pytest.mark.parametrize("chunk", [1, 256, 2000])
@pytest.mark.parametrize("burst_ns", [0, 600 * MS])
def test_what_comes_in_a_burst_after_a_stall_is_joined(chunk, burst_ns):
    """Ten seconds of every stream, one after another, cost no sample; what was late by its stamps alone does."""
    names = ["tam_3", "scalar", "tam_1", "tam_4", "tam_2"]
    messages = stalled(names, 200, 1200, chunk, burst_ns)
    synchroniser = Synchroniser(CROSS, MS, expected=["scalar"])
    samples = push_all(synchroniser, messages)
    assert [sample.stamp_ns for sample in samples] == [START + index * PERIOD for index in range(1500)]
    assert synchroniser.explain_losses() == "1500 of 1500 samples synchronised"
    assert [sample.values[12] for sample in samples] == [sample.stamp_ns / 1e9 for sample in samples]


def test_a_stream_whose_clock_lags_is_joined_in_a_stall_alone():
    """Stamps that are 0.4 s behind all the time are of another clock: only while all comes late that cannot be told."""
    names = ["tam_1", "tam_2"]
    messages = [
        (name, stamp - 400 * MS * (name == "tam_2"), *others)
        for name, stamp, *others in stalled(names, 500, 700, 1, 100 * MS)
    ]
    synchroniser = Synchroniser(SampleLayout(2), MS)
    samples = [sample.stamp_ns - START for sample in push_all(synchroniser, messages)]
    assert min(samples) > 4600 * MS and max(samples) < 8000 * MS and len(samples) < 300
    assert synchroniser.drops_everything


@pytest.mark.parametrize("slower", [1, 3, 100])
def test_samples_are_not_held_up_for_ever_by_a_recording_that_is_played_slowly(slower):
    """Each message comes later than its stamp tells; samples without a scalar still come, two samples late at most."""
    layout = SampleLayout(1, ("scalar",))
    synchroniser = Synchroniser(layout, MS, expected=["scalar"])
    delivered = [
        len(synchroniser.push(*message("tam_1", START + 100 * MS * index), START + slower * 100 * MS * index))
        for index in range(100)
    ]
    assert sum(delivered) >= 95


def test_a_clock_of_arrival_that_is_set_back_holds_up_nothing():
    """After a stall it is an hour earlier: samples without a scalar come with the usual patience."""
    synchroniser = Synchroniser(SampleLayout(1, ("scalar",)), MS, expected=["scalar"])
    count = 0
    for index in range(300):
        arrived = START + index * PERIOD + (10**10 if index == 100 else 0) - (3600 * 10**9 if index > 100 else 0)
        count += len(synchroniser.push(*message("tam_1", START + index * PERIOD), arrived))
    assert count > 270
