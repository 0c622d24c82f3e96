"""Rates of change of the field."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.motion import is_chance, jumps, rates, sum_around


def test_the_rate_of_a_turning_field_is_its_derivative(turning):
    """In continuous motion the derivative agrees with that of the attitudes to a millionth, at holes less well."""
    covariates = turning()
    finer = turning(samples=120_000, step_s=0.0005)
    expected = np.gradient(finer.field_T, 0.0005, axis=0)[::100]
    kept = np.r_[0:400, 500:1200]
    broken = covariates.take(kept)
    assert len(broken.stretches) == 2
    error = np.abs(rates(broken) - expected[kept]).max(axis=1) / np.abs(expected).max()
    assert error.max() < 1e-3
    assert np.median(error) < 1e-6


def test_irregular_sampling_is_followed(turning):
    """Times that jitter by a third of a step change nothing."""
    finer = turning(samples=60_000, step_s=0.001)
    generator = np.random.default_rng(2)
    kept = 50 * np.arange(1, 1199) + generator.integers(-16, 17, 1198)
    expected = np.gradient(finer.field_T, 0.001, axis=0)[kept]
    assert_allclose(rates(finer.take(kept))[10:-10], expected[10:-10], atol=1e-4 * np.abs(expected).max())


def test_a_sample_is_not_in_its_own_rate(turning):
    """Noise of a sample does not meet itself in a regression."""
    covariates = turning(samples=50)
    field = covariates.field_T.copy()
    field[20] += 1e-6
    changed = np.flatnonzero((rates(replace(covariates, field_T=field)) != rates(covariates)).any(axis=1))
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
    is_zero = (rates(replace(covariates, time_s=time_s)) == 0).all(axis=1)
    assert is_zero.any() == (not is_told)


@pytest.mark.parametrize(("step_s", "is_motion"), [(1.0, True), (1.25, False)])
def test_turns_that_a_polynomial_follows_are_motion(turning, step_s, is_motion):
    """Sampled once a second it misses a quarter of a step, more rarely half of one."""
    assert (jumps(turning(samples=400, step_s=step_s)) is None) == is_motion


@pytest.mark.parametrize("shape", [(30,), (30, 2), (30, 2, 3)])
def test_sums_are_those_of_the_samples_on_either_side(shape):
    """Fewer at the ends, and never the sample itself."""
    values = np.random.default_rng(1).normal(size=shape)
    expected = [values[max(n - 4, 0) : n + 5].sum(axis=0) - values[n] for n in range(30)]
    assert_allclose(sum_around(values, 4), expected, atol=1e-12)


RATE = np.random.default_rng(1).uniform(0, 1, 1000)


def dealt_out(rate):
    """Return all ways in which residuals are dealt out, those as they are first."""
    seen = []

    def statistic(dealt):
        seen.append(dealt.copy())
        return 1.0 if len(seen) == 1 else 0.0

    assert not is_chance(statistic, rate)
    return seen


def test_residuals_are_dealt_out_two_hundred_times():
    """All other ways differ from the one observed, and from each other."""
    observed, *others = dealt_out(RATE)
    assert observed.tolist() == list(range(1000)) and len(others) == 200
    assert len({tuple(one) for one in others}) == 200


def test_no_sample_keeps_its_own_and_all_come_from_like_motion():
    """A residual moves to a sample whose rate is among the next two hundred in order, and to any of these."""
    place = np.argsort(np.argsort(RATE))
    moved = np.array([np.abs(place[one] - place) for one in dealt_out(RATE)[1:]])
    assert moved.min() > 0 and 150 < moved.max() < 200
    for one in dealt_out(RATE)[1:4]:
        assert sorted(one) == list(range(1000))


def test_one_permutation_that_reaches_as_much_is_enough():
    """Even the last of them."""
    for reached, told in ((2.0, True), (1.0, True), (0.9, False)):
        values = iter([1.0, *[0.0] * 199, reached])
        assert is_chance(lambda dealt, values=values: next(values), RATE) == told


def test_what_follows_the_motion_is_no_chance():
    """Products with what each sample does stand out where they are real, and hardly ever otherwise."""
    generator = np.random.default_rng(2)
    found = []
    for strength in (0.3, *[0.0] * 100):
        path = generator.normal(size=1000)
        residual = strength * path + generator.normal(size=1000)
        found.append(not is_chance(lambda dealt, path=path, one=residual: float(path @ one[dealt]), np.abs(path)))
    assert found[0] and sum(found[1:]) <= 3


def test_a_short_record_is_dealt_out_as_a_whole():
    """Twenty samples, fewer than are alike, do not fail."""
    assert is_chance(lambda dealt: 1.0, RATE[:20])
