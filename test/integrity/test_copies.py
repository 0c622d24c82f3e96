from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.integrity import repeated
from tam_calibration.integrity.check import faults_of
from tam_calibration.model.array import Array


def test_a_sensor_that_repeats_another_is_named(run):
    """With whom it repeats."""
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((slice(None), 1), readings[:, 0])).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("repeated", 2, "", False)
    assert fault.sentence == "sensor 2 repeats sensor 1 throughout: it is no sensor of its own"


@pytest.mark.parametrize("late", [1, 7, 400])
@pytest.mark.parametrize(("copy", "original"), [(2, 1), (1, 4)])
def test_a_copy_may_be_late(run, late, copy, original):
    """By any number of samples; it is the later one that is named."""

    def repeat(readings):
        readings[late:, copy - 1] = readings[:-late, original - 1].copy()

    (fault,) = run.spoiled(repeat).faults
    assert (fault.name, fault.sensor) == ("repeated", copy)
    assert f"sensor {copy} repeats sensor {original} {late} sample" in fault.sentence


def test_a_copy_for_a_while_is_told_with_its_times(run):
    """Three seconds of fifteen."""
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((slice(300, 600), 3), readings[300:600, 1])).faults
    assert (fault.name, fault.sensor) == ("repeated", 4)
    assert fault.time_s == pytest.approx((3.0, 5.99), abs=1e-9)


def test_the_shortest_copy(run):
    """Ten readings in a row."""

    def told_of(length):
        span = slice(300, 300 + length)
        return run.spoiled(lambda readings: readings.__setitem__((span, 3), readings[span, 1])).told

    assert repeated.SHORTEST == 10
    assert told_of(9) == [] and told_of(10) == [("repeated", 4, "")]


def test_an_axis_that_repeats_another_but_for_scale_and_offset(run):
    """Of another sensor, or of its own."""
    own = run.spoiled(lambda readings: readings.__setitem__((slice(None), 1, 2), 0.7 * readings[:, 1, 0] + 1e-6))
    other = run.spoiled(lambda readings: readings.__setitem__((slice(None), 1, 2), 0.7 * readings[:, 3, 1] + 1e-6))
    assert own.told == [("repeated", 2, "z")]
    assert "sensor 4 axis y repeats sensor 2 axis z but for scale and offset" in other.faults[0].sentence


def test_alike_sensors_in_coarse_steps_are_no_copies(run):
    """Sensors without errors read the same number of microtesla in most samples; a copy does in all."""

    def alike(readings):
        noise = 1e-9 * np.random.default_rng(1).normal(size=readings.shape)
        readings[:] = np.round(readings[:, :1] + noise + 2e-8 * np.arange(4)[:, None], 6)

    bare = replace(run.spoiled(alike), array=Array(run.array.positions_m))
    same = np.mean(bare.recording.readings_T[:, 0] == bare.recording.readings_T[:, 1])
    assert same > 0.9
    assert bare.told == []
    copied = bare.spoiled(lambda readings: readings.__setitem__((slice(None), 2), readings[:, 1]))
    assert copied.told == [("repeated", 3, "")]


def test_noise_makes_no_copy(run):
    """Sensors that differ by a millionth of their range are two."""

    def nearly(readings):
        readings[:, 1] = readings[:, 0] + 1e-10 * np.random.default_rng(1).normal(size=(1500, 3))

    assert run.spoiled(nearly).told == []
    assert repeated.COPIED == 1 - 1e-13


def test_motion_in_a_plane_without_noise(run, true_errors):
    """Two axes that read the same as the field is in a plane are no copies: all sensors are flat."""
    angle = np.arange(1500) / 50
    field = 50e-6 * np.stack([np.cos(angle), 0.8 * np.sin(angle), 0.6 * np.sin(angle)], 1)
    flat = replace(run.recording, readings_T=true_errors.distort(field))
    assert [fault for fault in faults_of(flat, run.array) if fault.name == "repeated"] == []
