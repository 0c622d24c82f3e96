"""Noise that is drawn has the stated density."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal
from scipy.signal import welch

from tam_calibration.comparison import mend as mend_module
from tam_calibration.comparison.mend import NoiseTerm, slow_modes
from tam_calibration.comparison.streams import NoiseStream

RATE_HZ, SPAN_S, WHITE_T, KNEE_HZ = 50.0, 120.0, 1e-9, 2.0
SLOW = NoiseTerm(1, "y", WHITE_T, WHITE_T, KNEE_HZ, 1.0)
BAND = NoiseTerm(2, "z", WHITE_T, 0.0, band_hz=(9.0, 11.0), band_T=3e-9)
SCALAR = NoiseTerm(0, "", WHITE_T, 0.5e-9)


def drawn(terms, samples, seed=1, step_s=1 / RATE_HZ):
    """Return noise (N, 7) of two sensors and the scalar."""
    stream = NoiseStream(terms, 7, RATE_HZ, SPAN_S, np.random.default_rng(seed))
    return stream.drawn(step_s * np.arange(samples))


def density_error(exponent):
    """Return the largest relative error of the density of white and slow noise together."""
    constants_s, variances_T2 = slow_modes(NoiseTerm(1, "x", WHITE_T, 0.0, KNEE_HZ, exponent), RATE_HZ, SPAN_S)
    frequency = np.geomspace(1 / SPAN_S, RATE_HZ / 2, 400)
    decay = np.exp(-1 / (RATE_HZ * constants_s))
    transfer = 1 / np.abs(1 - decay * np.exp(-2j * np.pi * frequency / RATE_HZ)[:, None]) ** 2
    slow = 2 / RATE_HZ * transfer @ (variances_T2 * (1 - decay**2))
    white = 2 * WHITE_T**2 / RATE_HZ
    return np.abs((white + slow) / (white * (1 + (KNEE_HZ / frequency) ** exponent)) - 1).max()


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.5, 2.0])
def test_the_modes_have_the_density(exponent):
    """To a fiftieth at all frequencies that the recording showed; random walk, of one mode, to a twentieth."""
    assert density_error(exponent) < (0.05 if exponent == 2 else 0.02)


@pytest.mark.parametrize(("name", "value"), [("_PER_DECADE", 1), ("_FREQUENCIES", 8)])
def test_fewer_modes_or_frequencies_would_miss_it(monkeypatch, name, value):
    """The constants are as small as they can be, by a factor of a few."""
    monkeypatch.setattr(mend_module, name, value)
    assert max(density_error(exponent) for exponent in (0.5, 1.0, 1.5)) > 0.02


def test_what_is_drawn_has_the_density():
    """Averaged over many samples, the spectrum of the draw is white noise with a slow one."""
    frequency, density = welch(drawn([SLOW], 200_000)[:, 1], RATE_HZ, nperseg=3000)
    seen = (frequency > 0.1) & (frequency < 0.98 * RATE_HZ / 2)
    expected = 2 * WHITE_T**2 / RATE_HZ * (1 + KNEE_HZ / frequency[seen])
    ratio = density[seen] / expected
    assert np.mean(ratio) == pytest.approx(1, abs=0.02)
    assert np.mean(ratio[:60]) == pytest.approx(1, abs=0.08)


def test_a_band_is_where_and_as_large_as_stated():
    """Its variance is the stated one, half of it between the limits of the band, and nothing is elsewhere."""
    noise = drawn([BAND], 200_000)
    frequency, density = welch(noise[:, 5], RATE_HZ, nperseg=2000)
    assert noise[:, 5].std() == pytest.approx(3e-9, rel=0.02)
    inside = (frequency >= 9) & (frequency <= 11)
    assert density[inside].sum() / density.sum() == pytest.approx(0.5, abs=0.03)
    assert frequency[np.argmax(density)] == pytest.approx(10, abs=0.5)
    assert_array_equal(np.delete(noise, 5, axis=1), 0)


@pytest.mark.parametrize("limits_hz", [(9.0, 11.0), (3.5, 6.5), (13.0, 16.0)])
def test_a_band_is_an_autoregressive_process(limits_hz):
    """It has the density of the AR(2) process with its poles, from low frequencies on, a wide band too."""
    low, high = limits_hz
    noise = drawn([NoiseTerm(2, "z", WHITE_T, 0.0, band_hz=limits_hz, band_T=3e-9)], 300_000)[:, 5]
    frequency, density = welch(noise, RATE_HZ, nperseg=500)
    pole = np.exp(-np.pi * (high - low + 1j * (high + low)) / RATE_HZ)
    turn = np.exp(-2j * np.pi * frequency / RATE_HZ)
    expected = np.abs((1 - pole * turn) * (1 - pole.conj() * turn)) ** -2.0
    expected *= noise.var() / (expected.sum() * frequency[1])
    assert np.abs(density[3:-3] / expected[3:-3] - 1).max() < 0.2
    assert np.mean(density[3:20] / expected[3:20]) == pytest.approx(1, abs=0.05)


def test_white_noise_of_the_scalar():
    """What is added is the missing part, and it is in the last row."""
    noise = drawn([SCALAR], 40_000)
    assert noise[:, 6].std() == pytest.approx(0.5e-9, rel=0.02)
    assert np.corrcoef(noise[1:, 6], noise[:-1, 6])[0, 1] == pytest.approx(0, abs=0.02)


def test_slow_noise_is_the_same_at_another_rate():
    """A simulation that samples ten times as often has the same slow noise: its size does not change."""
    slow_only = NoiseTerm(1, "x", WHITE_T, 0.0, KNEE_HZ, 1.0)
    sizes = [
        np.mean([drawn([slow_only], 200 * often, seed, 0.02 / often)[:, 0].var() for seed in range(100)])
        for often in (1, 10)
    ]
    assert sizes[1] == pytest.approx(sizes[0], rel=0.15)


def test_a_single_mode_comes_nearest():
    """What simulators hold is one process: of white noise on a random walk it is all, to a hundredth."""
    walk = NoiseTerm(1, "x", WHITE_T, 0.0, 0.1, 2.0)
    (_, alone_T2), (_, all_T2) = slow_modes(walk, RATE_HZ, SPAN_S, True), slow_modes(walk, RATE_HZ, SPAN_S)
    assert alone_T2.sum() == pytest.approx(all_T2.sum(), rel=0.05)
    assert [len(each) for each in slow_modes(SLOW, RATE_HZ, SPAN_S, True)] == [1, 1]
    assert [len(each) for each in slow_modes(SCALAR, RATE_HZ, SPAN_S)] == [0, 0]


def test_it_begins_anew_where_time_goes_back():
    """The first sample of a second run has no memory of the first."""
    stream = NoiseStream([SLOW], 7, RATE_HZ, SPAN_S, np.random.default_rng(1))
    runs = np.array([stream.drawn(np.arange(50) / RATE_HZ)[[0, -1], 1] for _ in range(400)])
    assert abs(np.corrcoef(runs[1:, 0], runs[:-1, 1])[0, 1]) < 0.15
    assert runs[:, 0].std() == pytest.approx(runs[:, 1].std(), rel=0.2)
