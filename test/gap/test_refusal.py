"""What is too still for any verdict is told by the weakest field that there can be."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.gap.diagnose import is_at_rest, needed_samples, too_short
from tam_calibration.gap.nominal import without_calibration
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds


@pytest.mark.parametrize(("spread_T", "expected"), [(0.145e-6, True), (0.155e-6, False)])
def test_less_than_a_hundredth_of_the_weakest_field_across_is_rest(run, spread_T, expected):
    """0.15 µT on Earth; in a shielded room as much less as the field is weaker."""
    made = run(400, 1)
    shape = np.random.default_rng(2).normal(size=(400, 1, 3))
    shape -= shape.mean(axis=0)
    shape = shape @ np.linalg.inv(np.linalg.cholesky(np.cov(shape[:, 0], rowvar=False, bias=True))).T
    readings = 40e-6 + shape * [10 * spread_T, spread_T, 0.1 * spread_T]
    recording = replace(made.recording, readings_T=readings)
    assert is_at_rest(recording, EARTH_FIELD) is expected
    assert is_at_rest(recording, FieldBounds(7.5e-6, 50e-6)) is False
    assert is_at_rest(recording, FieldBounds(30e-6, 50e-6)) is True


@pytest.mark.parametrize(("sensors", "samples"), [(1, 69), (2, 24), (4, 24)])
def test_a_verdict_takes_sixty_channels_beyond_the_calibration(sensors, samples):
    """One sensor has twelve parameters less three and a channel each sample; more sensors take 24 samples."""
    assert needed_samples(sensors) == samples


def test_twice_as_many_samples_as_needed_are_asked_for(run):
    """Of a recording that is too short it is said how long it is and how long it should be."""
    gap = too_short(run(60, 1).recording.take(slice(5)))
    assert gap.next_recording.startswith("Record 138 samples or more")
    assert "it takes 69 samples at least, not 5 samples of 1 sensor." in gap.statement


@pytest.mark.parametrize("objection", [None, "scale factors of sensor 2 that differ by a factor of 3"])
def test_without_a_calibration_the_time_and_the_objection_are_told(run, objection):
    """What speaks against the one that fits best, where there is one."""
    recording = run(300).recording
    told = without_calibration(recording, objection)
    first, last = recording.time_span_s
    assert f"fits the readings between {first:.1f} and {last:.1f} s" in told
    assert told.endswith(" s" if objection is None else f": the one that fits best has {objection}")
