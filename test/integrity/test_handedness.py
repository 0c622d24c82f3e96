from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


def reversed_axes(**axes):
    """Return what turns axes of sensors round: ``sensor_1="y"``."""

    def change(readings):
        for name, letters in axes.items():
            for letter in letters:
                readings[:, int(name[-1]) - 1, "xyz".index(letter)] *= -1

    return change


@pytest.mark.parametrize("sensor", [1, 2, 3, 4])
@pytest.mark.parametrize("axis", ["x", "y", "z"])
def test_a_reversed_axis_is_named(run, sensor, axis):
    """Of the sensor that has it, also of sensor 1, against the three others."""
    (fault,) = run.spoiled(reversed_axes(**{f"sensor_{sensor}": axis})).faults
    assert (fault.name, fault.sensor, fault.axis, fault.may_be_effect) == ("mirrored", sensor, axis, False)
    assert f"axis {axis} is reversed" in fault.sentence


@pytest.mark.parametrize(
    ("order", "sign", "way"),
    [
        ([1, 0, 2], 1, "axes x and y are exchanged"),
        ([0, 2, 1], 1, "axes y and z are exchanged"),
        ([0, 1, 2], -1, "all axes are reversed"),
    ],
)
def test_exchanged_axes_are_named(run, order, sign, way):
    """As they lie against those of the others."""
    (fault,) = run.spoiled(
        lambda readings: readings.__setitem__((..., 2, slice(None)), sign * readings[:, 2, order])
    ).faults
    assert (fault.name, fault.sensor) == ("mirrored", 3) and way in fault.sentence


@pytest.mark.parametrize("sensors", [(1, 2), (1, 4)])
def test_two_of_four_cannot_be_told_without_attitude(run, sensors):
    """That is said."""
    (fault,) = run.spoiled(reversed_axes(**{f"sensor_{sensor}": "y" for sensor in sensors})).faults
    assert (fault.name, fault.sensor) == ("mirrored", None)
    assert "which is left-handed can be decided only with recorded attitude" in fault.sentence


def test_attitude_tells_two_of_four(vehicle):
    """Each with its axis."""
    assert vehicle.spoiled(reversed_axes(sensor_1="y", sensor_4="x")).told == [
        ("mirrored", 1, "y"),
        ("mirrored", 4, "x"),
    ]


def test_attitude_tells_all_of_four(vehicle):
    """As the field of a place points north."""
    names = {f"sensor_{sensor}": "y" for sensor in (1, 2, 3, 4)}
    assert vehicle.spoiled(reversed_axes(**names)).told == [("mirrored", sensor, "y") for sensor in (1, 2, 3, 4)]


def test_attitude_tells_one_sensor_alone(vehicle):
    """And without attitude nothing can."""
    mirrored = vehicle.spoiled(reversed_axes(sensor_1="z"))
    assert mirrored.of(1, attitude=vehicle.recording.attitude).told == [("mirrored", 1, "z")]
    assert mirrored.of(1).told == []


def test_attitude_with_any_heading_accuses_nobody(vehicle):
    """A world that is turned round its vertical axis leaves sound sensors sound, one of them mounted turned."""
    from scipy.spatial.transform import Rotation

    for heading in range(0, 360, 30):
        turned = Rotation.from_euler("z", heading, degrees=True) * Rotation.from_quat(vehicle.recording.attitude)
        heading_to = replace(vehicle, recording=replace(vehicle.recording, attitude=turned.as_quat()))
        assert heading_to.told == []
        assert heading_to.spoiled(reversed_axes(sensor_3="xz")).told == []


def test_attitude_that_is_not_the_sensors_accuses_nobody(vehicle):
    """Of another run, or at rest."""
    names = {f"sensor_{sensor}": "y" for sensor in (1, 2, 3, 4)}
    for attitude in (vehicle.recording.attitude[::-1], np.tile([0.0, 0, 0, 1], (1500, 1))):
        mirrored = replace(vehicle, recording=replace(vehicle.recording, attitude=attitude))
        assert mirrored.spoiled(reversed_axes(**names)).told == []


def test_a_few_random_attitudes_are_enough(run):
    """Thirty samples tell the mirrored one of four."""
    scenario = replace(read_scenario("wu_table_1"), sample_count=30)
    few = replace(run, recording=simulate(scenario).recording, array=scenario.array)
    assert few.spoiled(reversed_axes(sensor_1="y")).told == [("mirrored", 1, "y")]
