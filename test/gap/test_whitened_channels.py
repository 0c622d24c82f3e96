"""Whitened channels are white under the model, and their normal equations are those of a dense construction."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from tam_calibration.effects.states import BiasJump
from tam_calibration.gap import whitened_channels as module
from tam_calibration.gap.regressors import Regressors, calibration_regressors, update
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.sensor_errors import SensorErrors


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("sensors", [1, 2, 4, 30])
def test_channels_are_white_under_the_model(run, sensors, has_scalar):
    """Unit variance, no correlation between channels nor from sample to sample; 3 K - 2 of them."""
    made = run(4000, sensors, has_scalar)
    channels = made.channels()
    common = np.sqrt(channels.precision) * channels.intensity_residual_T
    residual = np.column_stack([channels.differential, common])
    count, width = residual.shape
    assert width == 3 * sensors - 2 and channels.count == residual.size
    assert channels.energy == pytest.approx(np.sum(residual**2))
    # 5.5 standard deviations of a covariance from so many samples: one in ten million.
    limit = 5.5 / np.sqrt(count)
    assert_allclose(residual.T @ residual / count, np.eye(width), atol=limit * np.sqrt(2))
    assert np.abs(residual[1:].T @ residual[:-1] / count).max() < limit
    assert np.abs(residual.mean(axis=0)).max() < limit


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("sensors", [1, 2, 4])
def test_channels_are_those_of_a_dense_construction(run, dense, sensors, has_scalar):
    """The energy of each sample, and of a shift of each row, whatever basis the complement has."""
    made = run(50, sensors, has_scalar)
    channels, truth = made.channels(), dense(made)
    assert_allclose(channels.energy_per_sample, np.sum(truth.residual**2, axis=1), rtol=1e-7)
    information = np.einsum("ncr,nct->nrt", truth.slope, truth.slope)
    own = channels.row_direction[:, :, None] * channels.row_direction[:, None, :]
    assert_allclose(channels.coupling + channels.precision[:, None, None] * own, information, rtol=1e-6, atol=1e9)


@pytest.mark.parametrize("count", [1, 2, 3])
@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize("sensors", [2, 4])
def test_noise_along_directions_of_each_sample_is_whitened(run, sensors, has_scalar, count):
    """The energy is that of the inverse covariance 1 + Σ d dᵀ of each sample, with d what each spread does to it."""
    channels = run(50, sensors, has_scalar).channels()
    spreads = np.random.default_rng(4).normal(0, 5e-9, (count, 50, 3 * sensors + 1))
    root = np.sqrt(channels.precision)
    residual = np.column_stack([channels.differential, root * channels.intensity_residual_T])
    covariance = np.tile(np.eye(residual.shape[1]), (50, 1, 1))
    for one in spreads:
        along = np.column_stack([one[:, :-1] @ channels.directions, root * np.sum(channels.row_direction * one, 1)])
        covariance += along[:, :, None] * along[:, None, :]
    expected = np.einsum("ni,nij,nj->n", residual, np.linalg.inv(covariance), residual)
    assert_allclose(channels.whitened(list(spreads)).energy_per_sample, expected, rtol=1e-6)
    assert channels.whitened([]).energy == channels.energy


def random_design(generator, samples, row_count, feature_count, atoms, width, has_parts):
    """Return a design of random features, rows or parts that rows have, and columns, atoms that share one included."""
    return Regressors(
        1e-9 * generator.normal(size=(samples, feature_count)),
        generator.integers(feature_count, size=atoms),
        generator.normal(size=(atoms, row_count)) if has_parts else generator.integers(row_count, size=atoms),
        np.concatenate([np.arange(width), generator.integers(width, size=atoms - width)]),
        width,
    )


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    seed=st.integers(0, 2**32 - 1),
    sensors=st.sampled_from([1, 2, 4]),
    has_scalar=st.booleans(),
    has_holes=st.booleans(),
    features=st.tuples(st.integers(1, 3), st.integers(1, 8)),
    atoms=st.tuples(st.integers(6, 20), st.integers(6, 10)),
    has_parts=st.tuples(st.booleans(), st.booleans()),
    part=st.one_of(st.none(), st.tuples(st.integers(0, 20), st.integers(20, 40), st.integers(1, 5))),
    stride=st.integers(1, 4),
    piece=st.sampled_from([3, 8192]),
)
def test_normal_equations_are_those_of_a_dense_construction(
    run, dense, seed, sensors, has_scalar, has_holes, features, atoms, has_parts, part, stride, piece
):
    """For designs with shared and unshared features, any stride, slice and piece, samples given up, no scalar there."""
    made, generator = run(40, sensors, has_scalar), np.random.default_rng(seed)
    counted = generator.random(40) > 0.3 * has_holes
    if has_holes and has_scalar:
        scalar = np.where(generator.random(40) > 0.3, made.recording.scalar_T, np.nan)
        scalar[0] = made.intensity_T
        made = replace(made, recording=replace(made.recording, scalar_T=scalar))
    channels = made.channels(is_counted=counted, stride=stride)
    left, right = (
        random_design(generator, 40, made.row_count, feature_count, atom_count, 5, of_parts)
        for feature_count, atom_count, of_parts in zip(features, atoms, has_parts, strict=True)
    )
    chosen = slice(*part) if part else None
    samples = np.arange(40)[::stride][chosen or slice(None)]
    kept = samples[counted[samples]]
    first, second = (dense(made).of(one)[kept].reshape(-1, one.width) for one in (left, right))
    residual = dense(made).residual[kept].ravel()
    left, right = (replace(one, features=one.features[::stride]) for one in (left, right))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "ENOUGH_SAMPLES", piece)
        cross, score = channels.cross(left, right, chosen), channels.score(left, chosen)
        normal = channels.normal(left, chosen)
    size = max(np.abs(first.T @ first).max(), np.abs(second.T @ second).max(), 1e-9)
    assert_allclose(cross, first.T @ second, rtol=1e-7, atol=1e-7 * size)
    assert_allclose(score, first.T @ residual, rtol=1e-6, atol=1e-6 * np.sqrt(size * 40))
    assert_allclose(normal.information, first.T @ first, rtol=1e-7, atol=1e-7 * size)
    assert_allclose(normal.score, score)
    assert normal.energy == pytest.approx(np.sum(residual**2), rel=1e-6)
    present = np.isfinite(made.recording.scalar_T) if has_scalar else np.ones(40, dtype=bool)
    assert normal.count == len(kept) * (3 * sensors - 3) + present[kept].sum()


@pytest.mark.parametrize("sensors", [1, 4])
def test_the_calibration_is_linearised(run, sensors):
    """A small step of the errors leaves the energy that its design says, at readings without noise."""
    made = run(300, sensors, noise_T=1e-16)
    made = replace(made, array=replace(made.array, vector_noise_T=np.full(sensors, 1e-9), scalar_noise_T=1e-9))
    channels = made.channels()
    design = calibration_regressors(channels.covariates)
    step = 1e-6 * np.random.default_rng(4).normal(size=design.width)
    matrix, bias = update(made.errors, step, float(np.mean(channels.covariates.intensity_T)))
    errors = SensorErrors.from_matrix(matrix, bias)
    assert_allclose(errors.matrix, matrix, atol=1e-12)
    moved = WhitenedChannels.at(made.recording, made.array, errors, made.intensity_T)
    expected = step @ channels.cross(design, design) @ step
    assert moved.energy - channels.energy == pytest.approx(expected - 2 * step @ channels.score(design), rel=1e-3)


def test_white_noise_beyond_the_array_s_widens_the_channels(run):
    """Variance that a row has more is as if its sensor were noisier, for the sensors and the scalar."""
    made = run(200)
    variance = np.append(np.full(12, 3e-18), 4 * made.array.scalar_noise_T**2)
    array = replace(made.array, vector_noise_T=np.full(4, 2e-9), scalar_noise_T=np.sqrt(5) * made.array.scalar_noise_T)
    noisier = replace(made, array=array).channels()
    assert_allclose(made.channels(row_variance=variance).energy_per_sample, noisier.energy_per_sample, rtol=1e-9)


def test_what_is_added_is_taken_off(run):
    """Rows with a known signal have the channels that they have without it."""
    made = run(100)
    added = 1e-7 * np.random.default_rng(3).normal(size=(100, 13))
    disturbed = made.with_added(added)
    assert_allclose(
        disturbed.channels(added_T=added).energy_per_sample, made.channels().energy_per_sample, rtol=1e-5, atol=1e-5
    )
    assert disturbed.channels().energy > 100 * made.channels().energy


def test_the_misfit_is_told_by_the_same_channels(run, dense):
    """Effects that look at the residual see the shift of a row that explains a sample best."""
    made = run(80)
    made = replace(made, recording=replace(made.recording, scalar_T=np.where(np.arange(80) < 9, np.nan, 5e-5)))
    residuals, truth = made.channels().residuals, dense(made)
    information = np.sum(truth.slope**2, axis=1)
    score = np.einsum("nc,ncr->nr", truth.residual, truth.slope)
    assert_allclose(residuals.row_information, information, rtol=1e-6)
    assert_allclose(residuals.row_shift_T[9:], score[9:] / information[9:], rtol=1e-5, atol=1e-14)
    assert not residuals.row_shift_T[:9, -1].any() and np.isnan(residuals.common_mode[:9]).all()
    assert_allclose(residuals.channel_count, np.where(np.arange(80) < 9, 9, 10))


def test_terms_of_a_long_recording_are_kept_at_the_samples_that_are_fitted(run):
    """Thinned, with features shared as before, they make the design that those of all samples make."""
    channels = run(60).channels(stride=7)
    shape = {"time_s": 30.0}
    whole, kept = BiasJump().terms(channels.covariates, shape), channels.terms(BiasJump(), shape)
    assert len({id(term.features) for term in kept}) == 1
    assert all(term.features.shape == (9, 1) for term in kept)
    for one, other in zip(whole, kept, strict=True):
        assert_allclose(other.features, one.features[::7])
    assert_allclose(channels.design(kept).features, channels.design(whole).features)
