"""Samples go on without a sensor that is silent, and another one sets the pace while sensor 1 is."""

import numpy as np
import pytest

from tam_calibration.messages.point_cloud import SampleLayout
from tam_calibration.messages.stream import SILENCE_NS
from tam_calibration.messages.synchroniser import Synchroniser

MS = 1_000_000
PERIOD = 10 * MS
START = 10**18
SILENCE = 500 * MS
PATIENCE = 100 * MS
COUNT = 400
DIES, RETURNS = 100, 300


def sent(sensor, index, late_ns=0):
    """Return a message of a sensor, each value of which is its index."""
    return f"tam_{sensor}", START + index * PERIOD + late_ns, (float(index),) * 3


def run(dead, late_ns=(0, 0, 0, 0), span=(DIES, RETURNS), count=COUNT):
    """Return the synchroniser of four sensors some of which are dead for a while, and its samples with their delay."""
    synchroniser = Synchroniser(SampleLayout(4), 0, PATIENCE, silence_ns=SILENCE)
    samples = []
    for index in range(count):
        for sensor in (1, 2, 3, 4):
            if sensor not in dead or index not in range(*span):
                message = sent(sensor, index, late_ns[sensor - 1])
                samples += [(sample, message[1] - sample.stamp_ns) for sample in synchroniser.push(*message)]
    return synchroniser, [*samples, *((sample, 0) for sample in synchroniser.flush())]


def missing(sample):
    """Return the sensors that a sample lacks."""
    return {sensor + 1 for sensor in np.flatnonzero(np.isnan(np.reshape(sample.values, (4, 3))).any(axis=1))}


@pytest.mark.parametrize("dead", [{1}, {2}, {3}, {4}, {1, 2}, {3, 4}])
def test_samples_go_on_without_a_sensor_until_it_returns(dead):
    """Only those within the stated time of silence are lost; what is there is exact, and nothing but the dead is NaN.

    The first after the return may have gone out before the message came, as nothing waits for a sensor that is dead.
    """
    synchroniser, samples = run(dead)
    by_index = {(sample.stamp_ns - START) // PERIOD: sample for sample, _ in samples}
    first_without = DIES + SILENCE // PERIOD
    assert sorted(by_index) == [*range(DIES), *range(first_without, COUNT)]
    for index, sample in by_index.items():
        is_partial = first_without <= index < RETURNS
        assert missing(sample) == (dead if is_partial else set()) or (index == RETURNS and missing(sample) <= dead)
        assert set(np.array(sample.values)[np.isfinite(sample.values)]) == {float(index)}
    assert RETURNS - first_without <= synchroniser.partial <= RETURNS - first_without + 1
    assert synchroniser.delivered == len(samples) - synchroniser.partial


@pytest.mark.parametrize("dead", [{1}, {3}])
def test_samples_wait_no_longer_than_the_patience(dead):
    """And not at all once a sensor has been dead for that, be it the one that sets the pace."""
    _, samples = run(dead, span=(DIES, COUNT))
    delays = [delay for sample, delay in samples if missing(sample)]
    assert max(delays) <= PATIENCE
    assert set(delays[PATIENCE // PERIOD + 1 :]) == {0}


@pytest.mark.parametrize("dead", [{1}, {3}])
def test_sensors_with_stamps_of_their_own_go_on(dead):
    """The remaining ones are brought to the stamp of sensor 1, or of the one that stands in; a return costs three."""
    late_ns = (0, 2 * MS, 5 * MS, 7 * MS)
    synchroniser, samples = run(dead, late_ns)
    pace = 2 if 1 in dead else 1
    for sample, _ in samples:
        lacking = missing(sample)
        stamp = (sample.stamp_ns - START - late_ns[(pace if lacking else 1) - 1]) / PERIOD
        values = np.reshape(sample.values, (4, 3))[:, 0]
        told = [stamp + (late_ns[(pace if lacking else 1) - 1] - late) / PERIOD for late in late_ns]
        for sensor in {1, 2, 3, 4} - lacking:
            assert values[sensor - 1] == pytest.approx(told[sensor - 1], abs=1e-9)
    assert synchroniser.partial >= RETURNS - DIES - SILENCE // PERIOD - 1
    assert COUNT - len(samples) <= SILENCE // PERIOD + 8


@pytest.mark.parametrize("lost", [1, SILENCE // PERIOD - 1])
def test_fewer_losses_than_those_of_a_silence_make_no_partial_samples(lost):
    """They cost a sample each, at most, as what lies between two messages is interpolated."""
    synchroniser, samples = run({2}, span=(DIES, DIES + lost))
    assert len(samples) >= COUNT - lost and synchroniser.partial == 0


def test_a_sensor_that_never_sends_is_silent_from_the_start():
    """So is one that stands in for sensor 1 in its absence."""
    for dead in ({1}, {3}):
        synchroniser, samples = run(dead, span=(0, COUNT))
        assert synchroniser.delivered == 0
        assert len(samples) == synchroniser.partial >= COUNT - SILENCE // PERIOD - 1
        assert synchroniser.silent == [f"tam_{sensor}" for sensor in dead]


def test_one_sensor_alone_makes_no_samples():
    """Nor does one whose clock ran ahead of all others take the pace from them."""
    _, samples = run({2, 3, 4}, span=(DIES, COUNT))
    assert len(samples) == DIES
    synchroniser, _ = run((), count=100)
    for index in range(100, COUNT):
        for sensor in (1, 2, 3, 4):
            synchroniser.push(*sent(sensor, index, 100_000 * MS if sensor == 2 else 0))
    assert synchroniser.partial == 0


@pytest.mark.parametrize("pause_ns", [2 * SILENCE, -2 * SILENCE, 100_000 * MS])
def test_a_pause_or_a_step_of_all_makes_no_sensor_silent(pause_ns):
    """Silence counts from the stamp at which the first goes on, in whichever order the others follow."""
    synchroniser = Synchroniser(SampleLayout(4), 0, PATIENCE, silence_ns=SILENCE)
    samples = []
    for index in range(COUNT):
        for sensor in (3, 1, 4, 2):
            samples += synchroniser.push(*sent(sensor, index, pause_ns if index > 200 else 0))
    samples += synchroniser.flush()
    assert synchroniser.partial == 0 and len(samples) >= COUNT - 2


def test_the_usage_counts_whole_samples():
    """And names the sensor for the others, sensor 1 too, for which another one set the pace."""
    partial = (RETURNS - DIES) - SILENCE // PERIOD
    usage = run({3})[0].usage
    assert (usage.used, usage.received) == (COUNT - RETURNS + DIES, COUNT)
    silent = f"which was silent in {partial} of them: check sensor, cable and driver"
    assert usage.reasons[0] == f"{RETURNS - DIES} found none of tam_3, {silent}"
    usage = run({1}, span=(DIES, COUNT))[0].usage
    assert (usage.used, usage.received) == (DIES, DIES + COUNT - DIES - SILENCE // PERIOD)
    assert "found none of tam_1, whose newest stamp is" in usage.reasons[0]
    assert f"{partial} more without a sensor that is silent" in run({1})[0].explain_losses()


def test_the_silence_by_default():
    """Two seconds: a sensor that is read at 1 Hz may lose a message."""
    synchroniser = Synchroniser(SampleLayout(3), 0, PATIENCE)
    for index in range(400):
        for sensor in (1, 2, 3)[: 3 if index < 100 else 2]:
            synchroniser.push(*sent(sensor, index))
    assert SILENCE_NS == 2_000 * MS
    assert synchroniser.partial == 400 - (99 + SILENCE_NS // PERIOD) - 1
