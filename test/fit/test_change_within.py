"""The time at which one calibration ends and another begins."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.fit.change_within import find_change
from tam_calibration.model.array import Array
from tam_calibration.simulation import simulate

COUNT = 600


def run_of(scenario, sensors=4, count=COUNT, seed=1):
    """Return a recording of the first sensors of a scenario, and their array."""
    recording = simulate(replace(scenario, sample_count=count, rate_hz=10.0, seed=seed)).recording
    own = replace(recording, readings_T=recording.readings_T[:, :sensors])
    return own, Array(scenario.array.positions_m[:sensors], np.full(sensors, 1e-9), 1e-10)


def with_offset(recording, course, size_T=10e-9):
    """Return a recording in which the last sensor's y has an offset of some course (N,)."""
    readings = recording.readings_T.copy()
    readings[:, -1, 1] += size_T * course
    return replace(recording, readings_T=readings)


@pytest.mark.parametrize(
    ("sensors", "first", "last"), [(1, 73, COUNT), (2, 550, COUNT), (4, 300, COUNT), (1, 200, 260), (4, 200, 260)]
)
def test_a_step_is_found_to_the_sample(wu_scenario, sensors, first, last):
    """Ten times the noise, of one, two and four sensors, whether it lasts or ends."""
    recording, array = run_of(wu_scenario, sensors)
    place = np.arange(COUNT)
    span = find_change(with_offset(recording, (place >= first) & (place < last)), array)
    assert abs(span.first - first) <= 1 and abs(span.last - last) <= 1
    assert span.inside_is_steady and span.outside_is_steady


@pytest.mark.parametrize(("sensors", "is_stated"), [(1, True), (2, False), (4, True)])
def test_without_a_change_none_is_found(wu_scenario, sensors, is_stated):
    """In six recordings each, with the noise stated or not, and with no scalar."""
    for seed in range(6):
        recording, array = run_of(wu_scenario, sensors, seed=seed)
        array = array if is_stated else Array(array.positions_m)
        assert find_change(recording, array) is None
        assert find_change(replace(recording, scalar_T=None), array) is None


@pytest.mark.parametrize(
    "course",
    [lambda part: part, lambda part: np.exp(-8 * part), lambda part: np.sin(6 * part)],
    ids=["ramp", "exp", "sine"],
)
def test_a_drift_is_no_change(wu_scenario, course):
    """Of it a further change explains as much again."""
    recording, array = run_of(wu_scenario)
    assert find_change(with_offset(recording, course(np.linspace(0, 1, COUNT)), 60e-9), array) is None


def test_a_step_of_a_noise_that_is_not_stated(wu_scenario):
    """Attitudes that jump look like noise; what is left in stretches is the noise."""
    recording, array = run_of(wu_scenario)
    span = find_change(with_offset(recording, np.arange(COUNT) >= 400), Array(array.positions_m))
    assert span.first == 400
    assert span.array.vector_noise_T == pytest.approx(np.full(4, 1e-9), rel=0.3)


def test_a_long_recording_is_thinned(wu_scenario):
    """The time of the step is right to the samples between those that are looked at, and all samples are told apart."""
    recording, array = run_of(wu_scenario, count=20_000)
    is_late = np.arange(20_000) >= 12_345
    span = find_change(with_offset(recording, is_late), array)
    assert span.some.sample_count < 2000
    assert abs(span.some.time_s[span.first] - 1234.5) < 2
    assert np.mean(span.of_all(span.is_inside, 20_000) != is_late) < 0.001


def test_too_few_samples_tell_no_change(wu_scenario):
    """Through thirty samples of a part nearly any ellipsoid passes."""
    recording, array = run_of(wu_scenario, count=59)
    assert find_change(with_offset(recording, np.arange(59) > 30, 1e-6), array) is None
