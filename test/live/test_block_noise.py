"""The noise of blocks is that of white noise, of noise that lasts, or of what does not become smaller in a mean."""

import numpy as np
import pytest
from live_mission import dive
from scipy.signal import lfilter

from tam_calibration.core.noise import WHITE
from tam_calibration.live.change_window import BlockMeans, BlockNoise

BLOCK, BLOCKS = 40, 60


def factors_of(errors, array, change, seed=1):
    """Return the factors of two minutes of 20 Hz after a function has changed readings (N, K, 3) and scalar (N,)."""
    generator = np.random.default_rng(seed)
    time_s = np.arange(BLOCK * BLOCKS) / 20
    rows = dive(errors, array, generator, time_s)
    readings_T, scalar_T = rows[:, 1:13].reshape(-1, 4, 3), rows[:, 13]
    change(generator, time_s, readings_T, scalar_T)
    noise = BlockNoise(array)
    for first in range(0, len(rows), BLOCK):
        some = slice(first, first + BLOCK)
        noise.add(BlockMeans.of(errors, readings_T[some], scalar_T[some]))
    return noise.factors(errors)


def test_white_noise_has_none(true_errors, cross):
    """In fifteen missions."""
    for seed in range(15):
        assert factors_of(true_errors, cross, lambda *_: None, seed) == WHITE


@pytest.mark.parametrize("part", [0.5, 0.8])
def test_noise_that_lasts_has_that_of_its_sums(true_errors, cross, part):
    """The sum of an AR(1) noise varies by (1 + a) / (1 - a) more, less what the ends of 40 samples take."""

    def lasting(generator, time_s, readings_T, scalar_T):
        white = generator.normal(size=readings_T.shape)
        filtered = lfilter([np.sqrt(1 - part**2)], [1, -part], white, axis=0)
        readings_T[:] = true_errors.distort(true_errors.restore(readings_T).mean(axis=1))
        readings_T += cross.vector_noise_T[0] * filtered

    lags = np.arange(1, BLOCK)
    expected = 1 + 2 * np.sum((1 - lags / BLOCK) * part**lags)
    assert factors_of(true_errors, cross, lasting).differential == pytest.approx(expected, rel=0.35)


def test_a_jump_is_no_noise(true_errors, cross):
    """Of a bias, half-way: most differences of the sensors do not contain it. The intensity turns with it."""

    def jump(generator, time_s, readings_T, scalar_T):
        readings_T[len(time_s) // 2 :, 1, 0] += 50e-9

    assert factors_of(true_errors, cross, jump).differential == 1


def test_what_is_slow_does_not_become_smaller_in_a_mean(true_errors, cross):
    """A scalar that follows a slow swing of 3 nT counts hardly any more; the sensors count as before."""

    def slow(generator, time_s, readings_T, scalar_T):
        scalar_T += 3e-9 * np.sin(2 * np.pi * time_s / 100)

    found = factors_of(true_errors, cross, slow)
    assert found.differential == 1 and found.common_mode > 1000
