"""The evidence of laws, from sums over the rows that they shift."""

import numpy as np
import pytest
from numpy.linalg import inv, slogdet
from numpy.testing import assert_allclose
from scipy.linalg import orth

from tam_calibration.gap.laws.evidence import Bins, Normal, Products, course
from tam_calibration.gap.laws.patterns import everywhere, in_sensor, of_motion
from tam_calibration.gap.laws.whitened import residual_of


@pytest.fixture
def residual(run):
    """Return the residual of a short run with noise alone."""
    return residual_of(run(120).model())


def nuisance_of(residual):
    """Return orthonormal changes (N, C, q): each row's by a bias, and by a gain of each component of the field."""
    rows, factors = residual.response[:, :, :-1], residual.seen.factors
    dense = np.concatenate([rows * one[:, None, None] for one in factors.T], axis=2).reshape(residual.z.size, -1)
    return orth(dense, rcond=3e-5).reshape(*residual.z.shape, -1)


@pytest.mark.parametrize("law", ["offset", "gain", "rate"])
def test_sums_over_rows_are_those_over_the_channels(residual, law):
    """A sample has more channels than rows that a law shifts, and the same products of both."""
    for pattern in (part for one in in_sensor(residual, 2) if one.law == law for part, _ in one.parts()):
        columns, sums = pattern.columns(residual), pattern.sums(residual, Bins.of_time(residual.time_s))
        assert_allclose(sums.information.sum(axis=0), np.einsum("ncp,ncq->pq", columns, columns), rtol=1e-9, atol=1e-9)
        assert_allclose(sums.score.sum(axis=0), np.einsum("ncp,nc->p", columns, residual.z), rtol=1e-6, atol=1e-9)
        cross, shared = np.einsum("ncp,ncq->pq", columns, nuisance_of(residual)), sums.cross.sum(axis=0)
        assert_allclose(shared @ shared.T, cross @ cross.T, rtol=1e-6, atol=1e-9)
        assert np.mean(np.sum(columns**2, axis=(1, 2))) == pytest.approx(columns.shape[2])


def test_normal_equations_are_those_of_the_columns(residual):
    """However a law's shifts are stated, and of each axis alone: a common field, values of each row, or of all rows."""
    for pattern in (*of_motion(residual, 2), *everywhere(residual)):
        normal = pattern.normal(residual)
        for part, chosen in pattern.parts():
            columns, own = residual.response[:, :, part.rows] @ part.features, normal.part(chosen)
            dense, score = np.einsum("ncp,ncq->pq", columns, columns), np.einsum("ncp,nc->p", columns, residual.z)
            assert_allclose(own.information, dense, rtol=1e-9, atol=1e-9 * max(np.abs(dense).max(), 1.0))
            assert_allclose(own.products[:, 0], score, rtol=1e-6, atol=1e-9 * max(np.abs(score).max(), 1.0))


def test_the_evidence_of_a_course_is_that_of_its_dense_equations(residual):
    """The likelihood of the residual with the course over that without, the nominal parameters eliminated."""
    pattern = next(in_sensor(residual, 1))
    bins = Bins.of(residual.time_s, 12)
    sums, length, variance = pattern.sums(residual, bins), 8.0, 0.7
    apart = np.abs(sums.place[:, None] - sums.place)
    prior = inv(np.kron(variance * np.exp(-apart / length), np.eye(3)))
    columns = np.zeros((residual.z.size, 36))
    for index, own in enumerate(bins.order):
        rows = np.zeros((residual.count, residual.z.shape[1], 3))
        rows[own[own >= 0]] = pattern.columns(residual)[own[own >= 0]]
        columns[:, 3 * index : 3 * index + 3] = rows.reshape(-1, 3)
    nuisance = nuisance_of(residual).reshape(residual.z.size, -1)
    clear = columns - nuisance @ (nuisance.T @ columns)
    precision = prior + clear.T @ clear
    score = columns.T @ residual.z.ravel()
    expected = (score @ inv(precision) @ score + slogdet(prior)[1] - slogdet(precision)[1]) / 2
    fit = course(sums, length, np.array([variance]))
    assert fit.evidence == pytest.approx(expected, abs=1e-4)
    assert_allclose(fit.mean.ravel(), inv(precision) @ score, atol=1e-6)


def test_what_no_channel_sees_has_no_evidence():
    """A row without response takes no coefficient."""
    unseen = np.zeros((50, 1, 1))
    fit = Normal.of(np.ones((50, 1, 1)), Products(unseen, unseen, np.zeros((50, 1, 3)), np.eye(3))).fit()
    assert (fit.evidence, fit.mean.tolist()) == (0, [[0]])
