from dataclasses import replace

import pytest

from tam_calibration.integrity import values
from tam_calibration.model.geomagnetic_field import FieldBounds

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
