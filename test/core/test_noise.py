"""The size of noise, and its correlation in time."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.noise import BLOCKS, COSINES, complete_noise, noise_energy, slow_cosines
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate

UNKNOWN = Array(np.zeros((1, 3)))


def test_noise_on_a_slow_motion_is_found():
    """White noise on a smooth tumble is found to a few per cent, per sensor, and so is the scalar's."""
    run = simulate(read_scenario("tumble_100_hz"))
    array, estimated = complete_noise(
        replace(run.scenario.array, vector_noise_T=None, scalar_noise_T=None), run.recording
    )
    assert estimated
    assert array.vector_noise_T == pytest.approx(1e-9, rel=0.1)
    assert array.scalar_noise_T == pytest.approx(1e-10, rel=0.1)


def test_of_a_long_recording_some_stretches_serve(monkeypatch):
    """A part of the blocks gives the same noise within its scatter."""
    monkeypatch.setattr("tam_calibration.model.recording.BLOCK", 500)
    monkeypatch.setattr("tam_calibration.core.noise.SKETCH", 2000)
    run = simulate(read_scenario("tumble_100_hz"))
    assert run.recording.sample_count == 2 * 2000
    array, _ = complete_noise(replace(run.scenario.array, vector_noise_T=None), run.recording)
    assert array.vector_noise_T == pytest.approx(1e-9, rel=0.1)


def test_stated_noise_is_kept(wu_run, wu_scenario):
    """What the array file says is not changed."""
    array, estimated = complete_noise(wu_scenario.array, wu_run.recording)
    assert not estimated
    assert (array.vector_noise_T == wu_scenario.array.vector_noise_T).all()


def test_scalar_noise_is_not_missed_where_there_is_no_scalar(wu_run, wu_scenario):
    """Without a scalar channel its noise need not be stated."""
    _, estimated = complete_noise(
        replace(wu_scenario.array, scalar_noise_T=None), replace(wu_run.recording, scalar_T=None)
    )
    assert not estimated


def test_one_sensor_that_jumps_between_attitudes_is_calibrated_without_stated_noise(wu_run):
    """Random attitudes do not pass for noise: the fit finds the bias, and tells the noise that is left."""
    alone = Recording(wu_run.recording.time_s, wu_run.recording.readings_T[:, :1])
    calibration = calibrate(alone, UNKNOWN)
    assert calibration.errors.bias_T[0] == pytest.approx(wu_run.errors.bias_T[0], abs=1e-9)
    assert calibration.array.vector_noise_T[0] == pytest.approx(1e-9, rel=0.15)


def test_a_channel_without_any_change_has_the_smallest_noise():
    """A quantised channel that holds its value is not taken for noise-free."""
    still = Recording(np.arange(10.0), np.full((10, 1, 3), 3e-5))
    array, _ = complete_noise(UNKNOWN, still)
    assert array.vector_noise_T[0] > 0


@pytest.mark.parametrize("freedom", [1, 3, 9])
def test_the_variance_of_noise_is_told_by_the_median_of_its_sums_of_squares(freedom):
    """Of 40 000 sums, a tenth of which are outliers: within the few per cent by which these move a median."""
    generator = np.random.default_rng(6)
    energy = np.sum((3 * generator.normal(size=(40_000, freedom))) ** 2, axis=1)
    assert noise_energy(energy, freedom) == pytest.approx(9, rel=0.03)
    energy[:4000] = 1e9
    assert 9 < noise_energy(energy, freedom) < 13


def test_they_are_orthogonal_to_each_other_and_to_the_mean():
    """So that their sums are independent for white samples, and have the variance of the plain sum."""
    cosines = np.column_stack([np.ones(BLOCKS), slow_cosines()])
    assert_allclose(cosines.T @ cosines, BLOCKS * np.eye(COSINES + 1), atol=1e-12 * BLOCKS)


def test_the_fastest_has_eight_blocks_in_a_period():
    """A constant that changes is met: four half cosines over sixteen blocks, the last with four changes of sign."""
    assert slow_cosines().shape == (16, 4)
    assert [int(np.sum(np.diff(np.sign(one)) != 0)) for one in slow_cosines().T] == [1, 2, 3, 4]
