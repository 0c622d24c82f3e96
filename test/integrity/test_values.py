from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.integrity import values
from tam_calibration.model.array import Array


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
