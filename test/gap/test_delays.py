"""Delays of the sensors' stamps, estimated from the motion of the array."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.interpolation import without_delays
from tam_calibration.gap import delays
from tam_calibration.gap.delays import estimate_delays
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate


def delayed(delays_ms, seed):
    """Return half a minute of a tumble at 100 Hz whose sensors read whole milliseconds before their stamps."""
    scenario = replace(read_scenario("tumble_100_hz"), sample_count=30_100, rate_hz=1000.0, seed=seed)
    made = simulate(scenario)
    places = np.arange(50, 30_050, 10)
    readings = [made.recording.readings_T[places - late, sensor] for sensor, late in enumerate(delays_ms)]
    return replace(made.recording.take(places), readings_T=np.stack(readings, axis=1)), scenario.array


@pytest.mark.parametrize(
    ("delays_ms", "seed"),
    [((0, 20, -13, 7), 1), ((0, 20, -13, 7), 2), ((0, 1, 0, -20), 1), ((0, 1, 0, -20), 2), ((0, 0, 0, 0), 11)],
)
def test_delays_up_to_twenty_milliseconds_are_found(delays_ms, seed):
    """Within three standard errors, which are some microseconds; also none, where their signs are those of noise."""
    recording, array = delayed(delays_ms, seed)
    found = estimate_delays(recording, array)
    error = found.delay_s - 1e-3 * np.array(delays_ms)
    assert found.delay_s[0] == 0 and found.standard_error_s[0] == 0
    assert np.all(np.abs(error[1:]) < 3 * found.standard_error_s[1:])
    assert np.all(np.abs(error) < 50e-6)


def test_without_its_delays_a_recording_reads_what_all_sensors_read_at_once():
    """To the last bit where the delay is a whole number of samples; at the ends some samples are lost."""
    late, _ = delayed((0, 20, -13, 7), 3)
    true, array = delayed((0, 0, 0, 0), 3)
    mended = without_delays(late, np.array([0, 20e-3, -13e-3, 7e-3]))
    _, same, _ = np.intersect1d(true.time_s, mended.time_s, return_indices=True)
    assert len(mended.time_s) >= len(true.time_s) - 8
    difference = mended.readings_T - true.readings_T[same]
    assert not difference[:, :2].any()
    assert_allclose(difference.std(axis=(0, 2))[2:], np.sqrt(2) * array.vector_noise_T[2:], rtol=0.1)


def test_poses_tell_no_delay(wu_run):
    """An array that jumps from pose to pose has no rate to see a delay by."""
    with pytest.raises(InputError, match="turn the array fast and continuously"):
        estimate_delays(wu_run.recording, wu_run.scenario.array)


@pytest.fixture
def steps(monkeypatch):
    """Return a list of the steps of sensor 2's delay, in standard errors of a microsecond; the last goes on."""
    parts = []

    def step(recording, array):
        part = parts.pop(0) if len(parts) > 1 else parts[0]
        return np.array([part * 1e-6, 0, 0]), np.full(3, 1e-6)

    monkeypatch.setattr(delays, "_step", step)
    return parts


def test_delays_are_settled_within_a_hundredth_of_their_standard_errors(steps):
    """A step that is larger is followed by another."""
    recording, array = delayed((0, 0, 0, 0), 1)
    steps += [5, -0.0101, 0.0099, 7]
    assert_allclose(estimate_delays(recording, array).delay_s, [0, 4.9998e-6, 0, 0], rtol=1e-9)
    assert steps == [7]


@pytest.mark.parametrize(("before", "is_refused"), [(11, False), (12, True)])
def test_delays_that_do_not_settle_are_refused(steps, before, is_refused):
    """After twelve steps: more than delays is unknown."""
    recording, array = delayed((0, 0, 0, 0), 1)
    steps += [*[1] * before, 0]
    if not is_refused:
        assert estimate_delays(recording, array).delay_s[1] == pytest.approx(11e-6)
        return
    with pytest.raises(Refused, match="do not settle"):
        estimate_delays(recording, array)


def test_standard_errors_do_not_ask_for_the_stated_noise():
    """They are scaled by the residual: a sheet that states 1.6 times the noise makes them no larger."""
    recording, array = delayed((0, 20, -13, 7), 1)
    sheets = (array, replace(array, vector_noise_T=1.6 * array.vector_noise_T))
    errors = [estimate_delays(recording, sheet).standard_error_s for sheet in sheets]
    assert_allclose(*errors, rtol=0.02)


def test_standard_errors_are_those_of_the_noise_over_the_rate():
    """Of a sensor alone the noise over the root of the summed squares of its rate; more beside what is not known."""
    recording, array = delayed((0, 20, -13, 7), 1)
    rate = np.gradient(recording.readings_T, recording.time_s, axis=0)
    alone = array.vector_noise_T / np.sqrt(np.sum(rate**2, axis=(0, 2)))
    ratio = estimate_delays(recording, array).standard_error_s[1:] / alone[1:]
    assert ((ratio > 1) & (ratio < 2)).all()
