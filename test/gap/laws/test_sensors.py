"""The sensors in which a law is, where more than one has it."""

import numpy as np
import pytest

from tam_calibration.gap.laws.signature import laws_of
from tam_calibration.gap.laws.whitened import residual_of


def first_law(run, sizes_T, course):
    """Return the first law of a run to whose sensors (from 1) offsets with one course (N,) are added."""
    added = np.zeros((run.recording.sample_count, run.row_count))
    for sensor, size_T in sizes_T.items():
        added[:, 3 * sensor - 3 : 3 * sensor] = np.outer(course, size_T)
    residual = residual_of(run.with_added(added).model())
    return laws_of(residual, residual.excess)[0].signature


OWN = {1: [3e-9, 0, 1e-9], 2: [0, -2e-9, 2e-9], 3: [1e-9, 2e-9, 0], 4: [-1e-9, 0, 3e-9]}


@pytest.mark.parametrize("sensors", [(1, 2), (2, 4), (1, 2, 3, 4)])
def test_a_law_that_follows_a_channel_is_in_the_sensors_that_have_it(run, sensors):
    """Offsets by the current, along another direction in each sensor: those that have none are not named."""
    clean = run(samples=500)
    found = first_law(clean, {one: OWN[one] for one in sensors}, clean.recording.current_A)
    assert (found.law, found.course, found.sensors) == ("offset", "channel", sensors)
    assert found.energy > 0.9


@pytest.mark.parametrize("sensors", [(1, 3), (1, 2, 3, 4)])
def test_a_tone_is_in_the_sensors_that_have_it(run, sensors):
    """A tone that two sensors pick up, or all."""
    clean = run(samples=500)
    time_s = clean.recording.time_s
    tone = np.sin(2 * np.pi * 0.31 / np.median(np.diff(time_s)) * time_s)
    found = first_law(clean, {one: OWN[one] for one in sensors}, tone)
    assert (found.law, found.course, found.sensors) == ("offset", "tone", sensors)


def test_what_all_but_one_have_may_be_in_all(run):
    """A field at all sensors beside an opposite one in the fourth is seen as one in three: all are named."""
    clean = run(samples=500)
    found = first_law(clean, {one: OWN[one] for one in (1, 2, 3)}, clean.recording.current_A)
    assert found.sensors == (1, 2, 3, 4)


def test_either_half_of_the_sensors_may_be_late(run):
    """Only differences between sensors show a delay: that two are late looks as if the other two were early."""
    clean = run(samples=900)
    sensed, time_s = clean.recording.readings_T - clean.errors.bias_T, clean.recording.time_s
    late = -2e-4 * np.gradient(sensed, time_s, axis=0)
    late[:, [0, 3]] = 0
    added = np.column_stack([late.reshape(900, -1), np.zeros(900)])
    residual = residual_of(clean.with_added(added).model())
    law = laws_of(residual, residual.excess)[0].signature
    assert (law.law, law.course) == ("rate", "constant")
    assert set(law.places) == {(2, 3), (1, 4)}
