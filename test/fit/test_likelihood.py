"""The normal equations against the energies that they are to describe."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.likelihood import (
    ChannelMaps,
    CommonModeSums,
    Likelihood,
    common_mode,
    expected_score,
    normal_equations,
    whitened,
)
from tam_calibration.fit.reference import interpolate
from tam_calibration.simulation import simulate

UNIT_T = 5e-5


@pytest.fixture(scope="module")
def scenario(wu_scenario):
    """Return 40 samples of Wu's run without noise."""
    array = replace(wu_scenario.array, vector_noise_T=None, scalar_noise_T=None)
    return replace(wu_scenario, array=array, sample_count=40)


def likelihood_of(run, scalar_noise=2e-6):
    """Return the likelihood of a run in units of order one; 1 nT of vector noise."""
    recording = run.recording
    noise = np.array([1.0, 2.0, 1.0, 0.5]) * 1e-9 / UNIT_T
    data = Normalized(recording, np.zeros((4, 3)), UNIT_T, has_scalar=True)
    return Likelihood(data, noise, scalar_noise)


@pytest.fixture(scope="module")
def at_truth(scenario):
    """Return a likelihood and the true matrices and biases."""
    run = simulate(scenario)
    return likelihood_of(run), run.errors.matrix, run.errors.bias_T / UNIT_T


def test_information_is_the_curvature_of_the_energy(at_truth):
    """A small step from the truth in any direction costs step · information · step, and leads back by Gauss-Newton."""
    likelihood, matrix, bias = at_truth
    generator = np.random.default_rng(5)
    information = likelihood.linearize(matrix, bias).both.information
    for _ in range(5):
        step = 1e-6 * generator.normal(size=len(information))
        rows = step.reshape(4, 3, 4)
        there = matrix + rows[..., :3], bias + rows[..., 3]
        point = likelihood.linearize(*there)
        expected = step @ information @ step
        assert likelihood.energy(*there).sum() == pytest.approx(expected, rel=1e-3)
        assert point.between.energy + point.common.energy == pytest.approx(expected, rel=1e-3)
        assert_allclose(point.both.score, -information @ step, atol=2e-3 * np.abs(information @ step).max())


def test_the_common_mode_s_part_is_what_the_intensities_tell(at_truth):
    """Without them it is nothing, and the rest stays; of one sensor it is all."""
    likelihood, matrix, bias = at_truth
    with_it = likelihood.linearize(matrix, bias + 1e-6)
    silent = replace(likelihood, intensity=np.full(40, np.nan)).linearize(matrix, bias + 1e-6)
    assert not silent.common.information.any() and not silent.common.score.any()
    assert_allclose(
        with_it.both.information - with_it.common.information, silent.both.information, rtol=1e-6, atol=1e-3
    )
    assert_allclose(with_it.both.score - with_it.common.score, silent.both.score, rtol=1e-6, atol=1e-3)
    first = replace(likelihood.data.source, readings_T=likelihood.data.source.readings_T[:, :1])
    data = replace(likelihood.data, source=first, origin_T=np.zeros((1, 3)))
    alone = replace(likelihood, data=data, vector_noise=likelihood.vector_noise[:1])
    one = alone.linearize(matrix[:1], bias[:1] + 1e-6)
    assert one.both.information.tolist() == one.common.information.tolist()
    assert one.both.score.tolist() == one.common.score.tolist()


def test_each_channel_is_weighed_by_its_own_factor(at_truth):
    """Parts of information and gradient add up again, energies and correction go with their channel."""
    likelihood, matrix, bias = at_truth
    whole = likelihood.linearize(matrix, bias + 1e-6)
    weighed = whole.weighed(VarianceFactors(4.0, 9.0))
    between = whole.both.information - whole.common.information
    assert_allclose(weighed.both.information, between / 4 + whole.common.information / 9, rtol=1e-9, atol=1e-3)
    towards = whole.both.score - whole.common.score
    assert_allclose(weighed.both.score, towards / 4 + whole.common.score / 9, rtol=1e-9, atol=1e-3)
    assert_allclose(weighed.common.information, whole.common.information / 9)
    assert_allclose(weighed.common.score, whole.common.score / 9)
    assert_allclose(weighed.correction, whole.correction / 9)
    assert weighed.between.energy == whole.between.energy / 4 and weighed.common.energy == whole.common.energy / 9
    assert weighed.common.count == whole.common.count


def test_interpolation_noise_reaches_the_common_mode_across_pieces(scenario, monkeypatch):
    """What samples share is taken over the whole run, however it is cut into pieces."""
    run = simulate(scenario)
    scalar = np.where(np.arange(40) % 5 == 0, run.recording.scalar_T, np.nan) / UNIT_T
    intensity, noise = interpolate(run.recording.time_s, scalar, 2e-6)
    likelihood = replace(likelihood_of(run, 0.0), intensity=intensity, interpolation_noise=noise)
    matrix, bias = run.errors.matrix + 1e-6, run.errors.bias_T / UNIT_T
    whole = likelihood.linearize(matrix, bias)
    monkeypatch.setattr("tam_calibration.model.recording.BLOCK", 7)
    pieces = likelihood.linearize(matrix, bias)
    assert_allclose(pieces.both.information, whole.both.information, rtol=1e-9)
    assert_allclose(pieces.both.score, whole.both.score, rtol=1e-9)
    alone = replace(likelihood, interpolation_noise=None).linearize(matrix, bias)
    assert whole.common.energy < alone.common.energy
    assert whole.common.count == 36


@pytest.mark.parametrize(("noisier", "part"), [(0.0, 0.0), (0.5, 0.25), (3.0, 1.0)])
def test_the_score_that_noise_makes_is_taken_off_as_far_as_there_is_noise(noisier, part):
    """It counts with the variance of the residuals over the stated one, but at most with the stated one."""
    generator, count = np.random.default_rng(3), 4000
    noise = np.full(4, 1e-4)
    field = generator.normal(size=(count, 3))
    field /= np.linalg.norm(field, axis=1, keepdims=True)
    rows = np.repeat(field[:, None], 4, axis=1).reshape(count, 12).T + noisier * 1e-4 * generator.normal(
        size=(12, count)
    )
    channels = ChannelMaps.at(np.broadcast_to(np.eye(3), (4, 3, 3)), np.zeros((4, 3)), noise)
    there = common_mode(channels, rows, 1 + noisier * 5e-5 * generator.normal(size=count), 5e-5)
    columns, score = whitened(there), expected_score(there)
    extended = np.concatenate([rows, np.ones((1, count))])
    plain, corrected = (
        normal_equations(
            channels, extended @ extended.T, CommonModeSums(columns @ columns.T, taken, count), count
        ).both.score
        for taken in (np.zeros_like(score), score)
    )
    whole = channels.response @ score
    assert_allclose(plain - corrected, part * whole, atol=0.05 * np.abs(whole).max())


def test_the_score_that_noise_makes_is_its_mean():
    """The mean over many samples of one field, with scale factors that differ by some per cent."""
    generator, count = np.random.default_rng(4), 400_000
    noise, field = np.full(2, 0.05), np.array([0.6, -0.5, 0.9])
    matrix = np.stack([np.diag([1.0, 1.05, 0.97]), np.diag([0.98, 1.02, 1.0])])
    channels = ChannelMaps.at(matrix, np.zeros((2, 3)), noise)
    rows = (matrix @ field).reshape(6, 1) + 0.05 * generator.normal(size=(6, count))
    there = common_mode(channels, rows, np.linalg.norm(field) + 0.01 * generator.normal(size=count), 0.01)
    columns = whitened(there)
    score = expected_score(there)
    by_chance = np.sqrt(np.sum((columns[:-1] * columns[-1]) ** 2, axis=1))
    assert np.abs(score).max() > 10 * by_chance.max()
    assert_allclose(columns[:-1] @ columns[-1], score, atol=4 * by_chance.max())
