from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.integrity import values
from tam_calibration.integrity.fault import refuse
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.geomagnetic_field import FieldBounds


@pytest.mark.parametrize(("low_T", "high_T", "which"), [(-1.0, 30e-6, "largest"), (-30e-6, 1.0, "smallest")])
def test_a_saturated_axis_is_named(run, low_T, high_T, which):
    """With the limit, the share of the samples there, and the effect by which a diagnosis finds it."""
    (fault,) = run.spoiled(lambda readings: readings[:, 1, 2].clip(low_T, high_T, out=readings[:, 1, 2])).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("saturated", 2, "z", True)
    assert fault.severity == "refusal" and f"stays at its {which} reading" in fault.sentence


def test_a_few_samples_at_the_end_are_a_warning(run):
    """Below a hundredth of them: a part that a fit bears."""
    ordered = np.sort(run.recording.readings_T[:, 1, 2])

    def clipped(count):
        limit = ordered[-count]
        (fault,) = run.spoiled(lambda readings: np.minimum(readings[:, 1, 2], limit, out=readings[:, 1, 2])).faults
        return fault.severity

    assert clipped(14) == "warning" and clipped(16) == "refusal"
    assert values.MANY_AT_END == 0.01


def test_five_samples_at_the_end_are_nothing(run):
    """Six are the fewest that no sound axis has."""
    ordered = np.sort(run.recording.readings_T[:, 1, 2])

    def clipped(count):
        limit = ordered[-count]
        return run.spoiled(lambda readings: np.minimum(readings[:, 1, 2], limit, out=readings[:, 1, 2])).told

    assert values.FEWEST_AT_END == 6
    assert clipped(5) == [] and clipped(6) == [("saturated", 2, "z")]


def test_a_turn_of_coarse_steps_is_not_saturated(run):
    """A sine stays longest in its last step, up to 2.4 times as long as in the next."""
    angle = np.arange(1500) / 40
    bare = replace(run, array=Array(run.array.positions_m))

    def turn(readings):
        for sensor in range(4):
            for axis in range(3):
                readings[:, sensor, axis] = (
                    np.round((49.5 + 0.3 * sensor) * np.sin((1 + 0.31 * axis) * angle + sensor)) * 1e-6
                )

    assert [told for told in bare.spoiled(turn).told if told[0] == "saturated"] == []


def test_readings_in_steps_far_above_the_noise_are_named(run):
    """A microtesla is 289 times a noise of 1 nT."""
    faults = run.spoiled(lambda readings: np.round(readings[:, 0], 6, out=readings[:, 0])).faults
    assert [(fault.name, fault.sensor, fault.axis) for fault in faults] == [("quantised", 1, axis) for axis in "xyz"]
    assert "in steps of 1000 nT" in faults[0].sentence and "289 times the stated noise" in faults[0].sentence
    assert faults[0].may_be_effect


@pytest.mark.parametrize(("step_T", "is_coarse"), [(34e-9, False), (36e-9, True)])
def test_steps_of_ten_times_the_noise(run, step_T, is_coarse):
    """Their error of rounding counts: a step over the root of twelve."""
    told = run.spoiled(lambda readings: readings.__setitem__((slice(None), 0), stepped(readings[:, 0], step_T))).told
    assert values.COARSE == 10
    assert bool(told) == is_coarse


def stepped(readings, step_T):
    """Return readings in steps."""
    return np.round(readings / step_T) * step_T


def test_steps_are_the_noise_where_none_is_stated(run):
    """The fit then estimates it, and its standard errors hold."""
    bare = replace(run, array=Array(run.array.positions_m))
    assert bare.spoiled(lambda readings: np.round(readings, 6, out=readings)).told == []


FACTORS = [1e-6, 1e-5, 1e-3, 1e-2, 1e2, 1e3, 1e5, 1e6]
"""Between nT, µT, mT and gauss, but for the ten of mT to gauss, which may be another range."""


def scaled(sensor, factor, axes=slice(None)):
    """Return what gives a sensor, numbered from 1, in another unit."""

    def change(readings):
        readings[:, sensor - 1, axes] *= factor

    return change


@pytest.mark.parametrize("factor", FACTORS)
def test_an_axis_in_another_unit_is_named(run, factor):
    """And how much it is out."""
    (fault,) = run.spoiled(scaled(2, factor, 2)).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("unit", 2, "z", False)
    times = factor if factor > 1 else 1 / factor
    assert f"about {times:.0f} times too {'much' if factor > 1 else 'little'}" in fault.sentence


def test_a_sensor_that_reads_noise_may_be_dead(run):
    """It varies far too little in all directions; as no calibration follows, accepting it is no advice."""
    noise_T = 1e-9 * np.random.default_rng(3).normal(size=(run.recording.sample_count, 3))
    (fault,) = run.spoiled(lambda readings: readings.__setitem__((..., 2, slice(None)), noise_T)).faults
    assert "it is dead, disconnected, or in another unit than the rest" in fault.sentence
    with pytest.raises(Refused, match=r"than the rest; correct that$"):
        refuse([fault])


@pytest.mark.parametrize("factor", FACTORS)
@pytest.mark.parametrize("sensor", [1, 3])
def test_a_sensor_in_another_unit_is_named(run, sensor, factor):
    """Not its axes one by one."""
    assert run.spoiled(scaled(sensor, factor)).told == [("unit", sensor, "")]


@pytest.mark.parametrize("factor", FACTORS)
def test_of_two_sensors_the_one_that_is_out(run, factor):
    """The Earth's field tells which."""
    assert run.spoiled(scaled(2, factor)).of(1, 2).told == [("unit", 2, "")]
    assert run.spoiled(scaled(2, factor)).of(2, 3).told == [("unit", 1, "")]


@pytest.mark.parametrize("factor", FACTORS)
def test_of_two_and_two_those_that_are_out(run, factor):
    """The same."""

    def change(readings):
        readings[:, [1, 2]] *= factor

    assert run.spoiled(change).told == [("unit", 2, ""), ("unit", 3, "")]
    assert run.spoiled(change).of(1, 2, 3, 4, scalar_T=run.recording.scalar_T).told == run.spoiled(change).told


@pytest.mark.parametrize("factor", FACTORS)
def test_the_scalar_in_another_unit_is_named(run, factor):
    """Where the sensors read a field of the Earth."""
    recording = replace(run.recording, scalar_T=factor * run.recording.scalar_T)
    (fault,) = replace(run, recording=recording).faults
    assert (fault.name, fault.sensor) == ("unit", None) and fault.sentence.startswith("the scalar reads")


def test_an_axis_of_one_sensor_alone(run):
    """No turntable stands so true that an axis varies three hundred times less than the others."""
    assert run.spoiled(scaled(1, 1e-3, 1)).of(1).told == [("unit", 1, "y")]
    assert run.spoiled(scaled(1, 1e3, 1)).of(1).told == [("unit", 1, "y")]


def test_a_tenth_is_another_range(run):
    """Of a scale factor the fit tells."""
    assert run.spoiled(scaled(2, 0.1)).told == [] and run.spoiled(scaled(2, 10, 1)).told == []
    assert values.APART == 30


def test_little_motion_is_no_unit(vehicle):
    """A vehicle that is hardly tilted varies little along z, in all sensors."""
    assert vehicle.told == []
    level = vehicle.recording.readings_T * [1, 1, 0.02]
    assert replace(vehicle, recording=replace(vehicle.recording, readings_T=level)).told == []


def test_a_scalar_that_the_array_file_contradicts_is_in_its_unit(run):
    """Where the sensors read what it reads, the file is wrong."""
    elsewhere = replace(run, array=replace(run.array, field=FieldBounds(20e-6, 30e-6)))
    assert elsewhere.told == []
