"""Whether residuals are noise: its size and its colour, less what the fit took out; and how often noise seems more."""

import numpy as np
import pytest
from scipy.fft import idct
from scipy.stats import chi2, f

from tam_calibration.localization.misfit import Misfit, misfit_of

SAMPLES, CHANNELS = 400, 12
NOTHING = np.zeros((1, 1))


def misfit(residuals):
    """Return what residuals are of which nothing was fitted."""
    return misfit_of(residuals, np.zeros((*residuals.shape, 1)), NOTHING)


def white(seed):
    """Return white residuals."""
    return np.random.default_rng(seed).normal(size=(SAMPLES, CHANNELS))


def wave(number, samples=SAMPLES):
    """Return one cosine (N,) of half periods over the samples, of energy one."""
    return idct(np.eye(samples)[number], norm="ortho")


def test_white_noise_is_noise():
    """Of the stated size it has nothing to widen."""
    assert misfit(white(1)) == Misfit(1.0, 1.0)
    assert misfit(white(1)).variance_factor == 1


@pytest.mark.parametrize("factor", [2.0, 0.5])
def test_white_noise_of_another_size_is_told(factor):
    """Twice the noise has four times the variance and no colour; half of it makes no standard error smaller."""
    found = misfit(factor * white(2))
    assert found.noise_variance == pytest.approx(factor**2, rel=4 * np.sqrt(2 / (SAMPLES * CHANNELS / 2)))
    assert found.colour == 1
    assert found.variance_factor == max(found.noise_variance, 1)


def test_noise_and_colour_widen_together():
    """A slow wave in noise of twice the stated size counts against that noise."""
    slow = np.zeros((SAMPLES, CHANNELS))
    slow[:, 4] = np.sqrt(480) * wave(2)
    alone, louder = misfit(white(3) + slow), misfit(2 * (white(3) + slow))
    assert alone.colour == pytest.approx(louder.colour, rel=1e-12)
    assert alone.noise_variance == 1
    assert louder.variance_factor == pytest.approx(4 * alone.colour, rel=0.15)


@pytest.mark.parametrize(("number", "band"), [(0, 4), (2, 4), (3, 4), (4, 12), (15, 12), (16, 48), (63, 48)])
def test_a_slow_wave_stands_out_of_its_band(number, band):
    """Bands are each four times as wide as all that is slower: a wave's energy counts over that of its own."""
    residuals = white(4)
    residuals[:, 7] += np.sqrt(1000) * wave(number)
    assert misfit(residuals).colour == pytest.approx(1 + 1000 / (band * CHANNELS), rel=0.25)


def test_a_wave_as_fast_as_the_noise_is_noise():
    """In the upper half there is no colour: it is what the noise is measured by."""
    residuals = white(5)
    residuals[:, 7] += np.sqrt(1000) * wave(300)
    found = misfit(residuals)
    assert found.colour == 1
    assert found.noise_variance == pytest.approx(1 + 1000 / (SAMPLES / 2 * CHANNELS), rel=0.1)


def fitted(residuals, numbers):
    """Return residuals of a fit of some cosines in every channel, its derivatives and its covariance."""
    waves = np.array([wave(number) for number in numbers]).T
    left = residuals - waves @ (waves.T @ residuals)
    slopes = np.einsum("nw,dc->ndwc", waves, np.eye(CHANNELS)).reshape(SAMPLES, CHANNELS, -1)
    return left, slopes, np.eye(slopes.shape[2])


def test_what_the_fit_took_out_of_a_band_is_accounted_for():
    """Three of the four slowest cosines are fitted: what is left of the band has the fourth's freedom only."""
    residuals = white(6)
    residuals[:, 7] += np.sqrt(300) * wave(3)
    left, slopes, covariance = fitted(residuals, range(3))
    assert misfit_of(left, slopes, covariance).colour == pytest.approx(1 + 300 / CHANNELS, rel=0.25)
    assert misfit_of(left, np.zeros((*left.shape, 1)), NOTHING).colour < 10


def test_what_the_fit_took_out_of_the_noise_is_accounted_for():
    """Half of the upper cosines fitted, the noise still has its variance; without the derivatives it would be half."""
    left, slopes, covariance = fitted(white(7), range(300, 400))
    assert misfit_of(left, slopes, covariance) == Misfit(1.0, 1.0)
    assert misfit(left).noise_variance == pytest.approx(0.5, rel=0.1)


def test_a_band_without_freedom_says_nothing():
    """Where all of a band was fitted rounding is no colour."""
    left, slopes, covariance = fitted(white(8), range(4))
    assert misfit_of(left, slopes, covariance).colour == 1


def test_noise_stands_out_once_in_a_thousand():
    """Of 2000 draws of white noise about two have a colour, and two another size."""
    draws = np.random.default_rng(9).normal(size=(2000, 32, 3))
    found = [misfit(draw) for draw in draws]
    assert sum(each.colour > 1 for each in found) <= 8
    assert sum(each.noise_variance != 1 for each in found) <= 8


@pytest.mark.parametrize(("part", "has_colour"), [(0.98, False), (1.02, True)])
def test_a_band_stands_out_from_its_chance_on(part, has_colour):
    """A thousandth, shared by the bands 0 to 3, 4 to 15 and 16 to 31, of Fisher's distribution."""
    ratio = part * f.isf(1e-3 / 3, 12 * 3, 32 * 3)
    energy = np.ones((64, 3))
    energy[4:16] = ratio
    assert (misfit(idct(np.sqrt(energy), axis=0, norm="ortho")).colour > 1) is has_colour


@pytest.mark.parametrize("samples", [1, 2, 3])
def test_few_samples_are_no_reason_to_widen(samples):
    """Of one sample, or two, there is no slow and no fast."""
    assert misfit(np.random.default_rng(10).normal(size=(samples, CHANNELS))).variance_factor == 1


@pytest.mark.parametrize("tail", [5e-4, 1 - 5e-4])
@pytest.mark.parametrize(("part", "is_told"), [(0.99, False), (1.01, True)])
def test_another_size_of_the_noise_is_told_from_its_chance_on(tail, part, is_told):
    """A thousandth, half of it above and half below, of χ² of the 32 upper cosines of three channels."""
    ratio = 1 + (chi2.isf(tail, 96) / 96 - 1) * part
    energy = np.ones((64, 3))
    energy[32:] = ratio
    found = misfit(idct(np.sqrt(energy), axis=0, norm="ortho")).noise_variance
    assert found == pytest.approx(ratio if is_told else 1)
