from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.integrity import repeated
from tam_calibration.integrity.check import faults_of
from tam_calibration.messages.samples import Samples
from tam_calibration.model.array import Array
from tam_calibration.recordings.fit_input import RecordingStream


def at(run, first, last):
    """Return times of samples to a hundredth of a second."""
    return pytest.approx((run.recording.time_s[first], run.recording.time_s[last]), abs=1e-9)


@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
def test_a_frozen_sensor_is_named_with_its_times(run, start_s):
    """From the first sample that is held to the last; words count seconds from the start, as --from and --until do."""
    run = replace(run, recording=replace(run.recording, time_s=run.recording.time_s + start_s))
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((slice(300, 400), 2), readings[300, 2])).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("frozen", 3, "", True)
    assert fault.time_s == at(run, 300, 399)
    assert fault.sentence == (
        "sensor 3 reads the same values between 3.00 and 3.99 s, where the others move: it is frozen"
    )


@pytest.mark.parametrize("value", [None, 0.0])
def test_a_frozen_axis_is_named(run, value):
    """At the value that it had, or at zero."""

    def freeze(readings):
        readings[300:400, 2, 1] = readings[300, 2, 1] if value is None else value

    (fault,) = run.spoiled(freeze).faults
    assert (fault.name, fault.sensor, fault.axis, fault.time_s) == ("frozen", 3, "y", at(run, 300, 399))


def test_a_dead_axis_is_no_effect(run):
    """One that never changes leaves a diagnosis nothing."""
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((slice(None), 2, 1), 3e-5)).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("frozen", 3, "y", False)


def test_the_shortest_hold(run):
    """Ten samples, two more than stale samples are late."""

    def held(length):
        return run.spoiled(lambda readings: readings.__setitem__((slice(300, 300 + length), 2), readings[300, 2])).told

    assert repeated.SHORTEST == 10
    assert held(9) == [] and held(10) == [("frozen", 3, "")]


def test_one_sensor_alone(run):
    """Its noise would show where it is not frozen; in coarse steps it may be at rest."""

    def hold(readings):
        readings[300:400, 2] = readings[300, 2]

    assert run.spoiled(hold).of(3).told == [("frozen", 1, "")]
    coarse = run.spoiled(lambda readings: (hold(readings), np.round(readings, 5, out=readings)))
    bare = coarse.of(3)
    assert faults_of(bare.recording, Array(np.zeros((1, 3)))) == []


def test_a_sensor_in_coarse_steps_that_stands_still_while_others_turn(run):
    """A microtesla is a fiftieth of its range, of which the others pass a tenth and more."""

    def hold(readings):
        readings[:] = np.round(readings, 6)
        readings[300:600, 2] = readings[300, 2]

    spoiled = run.spoiled(hold)
    assert [fault.name for fault in faults_of(spoiled.recording, Array(run.array.positions_m))] == ["frozen"]


def test_where_a_sine_of_coarse_steps_turns_back_it_is_not_frozen(run):
    """It stays in its last step for ten samples and more, and leaves it by one step."""
    stepped = run.spoiled(lambda readings: np.round(readings, 7, out=readings))
    assert [fault for fault in stepped.faults if fault.name == "frozen"] == []
    assert repeated.STEPS == 2


@pytest.mark.parametrize("count", [1, 40])
def test_zeros_are_named(run, count):
    """Be it one sample."""
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((slice(300, 300 + count), 1), 0)).faults
    assert (fault.name, fault.sensor, fault.may_be_effect) == ("zero", 2, True)
    assert fault.time_s == at(run, 300, 299 + count)


@pytest.mark.parametrize("size", [1, 7, 333, 350])
def test_a_hold_goes_on_from_block_to_block(run, size):
    """However a recording is cut: its times are the same."""

    def hold(readings):
        readings[300:400, 2] = readings[300, 2]
        readings[900:905, 0, 1] = readings[900, 0, 1]
        readings[350:380, 3] = 0

    spoiled = run.spoiled(hold)
    whole, cut = repeated.FrozenAxes(4), repeated.FrozenAxes(4)
    for block in spoiled.recording.blocks():
        whole.add(block)
        for start in range(0, len(block.time_s), size):
            cut.add(type(block)(*(values[start : start + size] for values in block)))
    assert whole.faults(spoiled.recording) == cut.faults(spoiled.recording)
    assert len(whole.faults(spoiled.recording)) == 2


def test_a_recording_on_disk_has_the_same_faults(run):
    """A stream is read block by block."""
    spoiled = run.spoiled(lambda readings: readings.__setitem__((slice(300, 400), 2), readings[300, 2]))
    assert faults_of(RecordingStream([Samples(spoiled.recording)]), run.array) == spoiled.faults
