"""What happens to the array, as far as it is known: holes of the record, and rates of change of the field."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.covariates import jumps


@pytest.mark.parametrize(("steps", "is_hole"), [(2.1, False), (4.2, True)])
def test_a_step_of_several_times_the_usual_one_is_a_hole(turning, steps, is_hole):
    """Two steps are a sample that was lost, four are the end of a stretch."""
    covariates = turning(samples=50)
    later = covariates.time_s + np.where(np.arange(50) >= 30, (steps - 1) * covariates.step_s, 0.0)
    found = replace(covariates, time_s=later).stretches
    assert [(one.start, one.stop) for one in found] == ([(0, 30), (30, 50)] if is_hole else [(0, 50)])


def test_the_rate_of_a_turning_field_is_its_derivative(turning):
    """In continuous motion the derivative agrees with that of the attitudes to a millionth, at holes less well."""
    covariates = turning()
    finer = turning(samples=120_000, step_s=0.0005)
    expected = np.gradient(finer.field_T, 0.0005, axis=0)[::100]
    kept = np.r_[0:400, 500:1200]
    broken = covariates.take(kept)
    assert len(broken.stretches) == 2
    error = np.abs(broken.rate_T_per_s - expected[kept]).max(axis=1) / np.abs(expected).max()
    assert error.max() < 1e-3
    assert np.median(error) < 1e-6


def test_irregular_sampling_is_followed(turning):
    """Times that jitter by a third of a step change nothing."""
    finer = turning(samples=60_000, step_s=0.001)
    generator = np.random.default_rng(2)
    kept = 50 * np.arange(1, 1199) + generator.integers(-16, 17, 1198)
    expected = np.gradient(finer.field_T, 0.001, axis=0)[kept]
    assert_allclose(finer.take(kept).rate_T_per_s[10:-10], expected[10:-10], atol=1e-4 * np.abs(expected).max())


def test_a_sample_is_not_in_its_own_rate(turning):
    """Noise of a sample does not meet itself in a regression."""
    covariates = turning(samples=50)
    field = covariates.field_T.copy()
    field[20] += 1e-6
    changed = np.flatnonzero((replace(covariates, field_T=field).rate_T_per_s != covariates.rate_T_per_s).any(axis=1))
    assert 20 not in changed
    assert set(changed) == {17, 18, 19, 21, 22, 23}


@pytest.mark.parametrize("rest", [1, 5, 40])
def test_poses_are_no_motion(turning, rest):
    """An array that rests in random poses, with noise, shows no continuous motion."""
    generator = np.random.default_rng(3)
    quaternion = np.repeat(generator.normal(size=(1200 // rest, 4)), rest, axis=0)
    covariates = turning(samples=len(quaternion), attitude=quaternion)
    noisy = replace(covariates, field_T=covariates.field_T + 1e-9 * generator.normal(size=covariates.field_T.shape))
    assert "jumps" in jumps(noisy)


@pytest.mark.parametrize("noise_T", [0.0, 1e-9, 300e-9])
def test_a_tumble_is_motion_in_spite_of_noise(turning, noise_T):
    """Noise that exceeds the change of a step does not hide the motion."""
    covariates = turning()
    noise = noise_T * np.random.default_rng(4).normal(size=covariates.field_T.shape)
    assert jumps(replace(covariates, field_T=covariates.field_T + noise)) is None


def test_few_samples_are_no_motion(turning):
    """A handful of samples tells nothing."""
    assert "too few" in jumps(turning(samples=8))


@pytest.mark.parametrize(("part", "is_told"), [(0.0145, True), (0.0085, False)])
def test_samples_that_nearly_coincide_tell_no_rate(turning, part, is_told):
    """A seventieth of a step apart their noise counts forty times, and less than a hundredth apart they are left."""
    covariates = turning(samples=60)
    time_s = covariates.time_s.copy()
    time_s[30] = time_s[29] + part * covariates.step_s
    is_zero = (replace(covariates, time_s=time_s).rate_T_per_s == 0).all(axis=1)
    assert is_zero.any() == (not is_told)


@pytest.mark.parametrize(("step_s", "is_motion"), [(1.0, True), (1.25, False)])
def test_turns_that_a_polynomial_follows_are_motion(turning, step_s, is_motion):
    """Sampled once a second it misses a quarter of a step, more rarely half of one."""
    assert (jumps(turning(samples=400, step_s=step_s)) is None) == is_motion
