"""A long recording in stretches: as many samples as a diagnosis takes, from all of the run, whole where it is short."""

from importlib import import_module

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.ndimage import uniform_filter1d

from tam_calibration.effects import courses
from tam_calibration.gap import diagnose
from tam_calibration.gap.diagnose import MOST_SAMPLES, STRETCH, in_stretches
from tam_calibration.messages.samples import Samples
from tam_calibration.model.recording import Recording
from tam_calibration.recordings.fit_input import RecordingStream


def long_recording(count):
    """Return samples of one sensor, a second apart, that read their own number."""
    number = np.arange(float(count))
    return Recording(number, np.repeat(number, 3).reshape(count, 1, 3))


def starts_of(recording):
    """Return the times at which stretches begin."""
    return recording.time_s[np.diff(recording.time_s, prepend=-np.inf) > 1]


def test_up_to_fifty_thousand_samples_none_is_left_out():
    """The recording itself is looked at, so that no answer can become another."""
    recording = long_recording(MOST_SAMPLES)
    assert in_stretches(recording) == (recording, ())
    assert (MOST_SAMPLES, STRETCH) == (50_000, 500)
    assert courses._MOST_STEPS > MOST_SAMPLES


@pytest.mark.parametrize("count", [MOST_SAMPLES + 1, 234_567, 1_000_000])
def test_more_samples_are_looked_at_in_a_hundred_stretches(count):
    """Each of five hundred samples that follow each other, one in each hundredth of the run; told in a sentence."""
    seen, (remark,) = in_stretches(long_recording(count))
    assert seen.sample_count == MOST_SAMPLES
    blocks = seen.time_s.reshape(-1, STRETCH)
    assert (np.diff(blocks, axis=1) == 1).all()
    part = np.arange(100)
    assert (blocks[:, 0] >= part * count // 100).all() and (blocks[:, -1] < (part + 1) * count / 100).all()
    assert f"Of {count} samples the diagnosis looks at 50000, in 100 stretches" in remark


@pytest.mark.parametrize("count", [300_000, 1_000_000, 10_000_000])
def test_nothing_that_comes_again_hides_between_the_stretches(count):
    """Whatever its period, the stretches begin at all of its phases: their mean unit vector is short."""
    starts = starts_of(in_stretches(long_recording(count))[0])
    for period in np.geomspace(50, count / 20, 4000):
        assert abs(np.exp(2j * np.pi * starts / period).mean()) < 0.4
    assert abs(np.exp(2j * np.pi * starts / 10_000).mean()) < 0.2


def test_a_recording_on_disk_gives_the_same_stretches():
    """It is never in memory as a whole."""
    recording = long_recording(150_000)
    starts = range(0, 150_000, 40_000)
    stream = RecordingStream(Samples(recording.take(slice(start, start + 40_000))) for start in starts)
    seen, remarks = in_stretches(recording)
    of_disk, same = in_stretches(stream)
    assert same == remarks
    assert_array_equal(of_disk.readings_T, seen.readings_T)


@pytest.fixture
def few(monkeypatch):
    """Let a diagnosis look at 450 samples only, in 15 stretches."""
    monkeypatch.setattr(import_module("tam_calibration.gap.diagnose"), "MOST_SAMPLES", 450)
    monkeypatch.setattr(import_module("tam_calibration.gap.diagnose"), "STRETCH", 30)


def added(made, cause):
    """Return what a cause of known size adds to sensor 2 y of a run (N,), tesla."""
    recording, unit_T = made.recording, 1e-9
    if cause == "temperature_drift":
        return unit_T * (recording.temperature_C - 20)
    if cause == "bias_jump":
        return 2 * unit_T * (recording.time_s > 37)
    field_T = uniform_filter1d(recording.readings_T[:, 1, 1], 31)
    return -1e-4 * np.gradient(field_T, recording.time_s)


@pytest.mark.parametrize(
    ("cause", "value", "size"),
    [
        ("temperature_drift", "offset", 1e-9),
        ("bias_jump", "offset", 2e-9),
        ("time_skew", "delay", 1e-4),
    ],
)
def test_causes_and_sizes_are_those_of_the_whole(run, few, cause, value, size):
    """What goes from sample to sample, what is slow, and what happens once; to some standard errors."""
    made = run(4500)
    gap = diagnose(made.with_row(4, added(made, cause)).recording, made.array)
    assert gap.verdict == "explained"
    (found,) = gap.causes
    assert (found.fitted.effect, found.sensors, found.axes) == (cause, (2,), ("y",))
    (part,) = found.fitted.contributions
    assert abs(abs(part.values[value]) - size) < 4 * part.standard_errors[value]
    assert gap.remarks[0].startswith("Of 4500 samples the diagnosis looks at 450, in 15 stretches")
