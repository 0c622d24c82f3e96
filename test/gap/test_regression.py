"""Least squares with the calibration eliminated explains what dense least squares explains."""

from math import log

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import TemperatureDrift
from tam_calibration.effects.curves import Nonlinearity
from tam_calibration.gap.regression import Base, Projected, columns_of, twice_log_likelihood_ratio
from tam_calibration.gap.regressors import Regressors

SHAPE = {"time_constant_s": 2.0, "reference_C": 20.0}


def drift_terms(channels, sensors=(1, 2)):
    """Return the drifts of offset and scale of some sensors."""
    terms = TemperatureDrift().terms(channels.covariates, SHAPE)
    return [term for term in terms if term.sensor in sensors and term.name in ("offset", "scale")]


@pytest.fixture
def made(run):
    """Return a run with a drift and a curve in it."""
    made = run(200)
    change = made.recording.temperature_C - 20
    return made.with_row(4, 3e-9 * change).with_row(8, 2e-5 * change * made.recording.readings_T[:, 2, 2])


@pytest.mark.parametrize(("sensors", "has_scalar"), [(1, True), (2, True), (2, False), (4, True), (4, False)])
def test_the_base_leaves_what_least_squares_leaves(run, dense, sensors, has_scalar):
    """The calibration is fitted exactly, the directions that the data leave open included."""
    made = run(150, sensors, has_scalar)
    channels = made.channels()
    base = Base(channels, [channels.calibration])
    assert base.energy == pytest.approx(dense(made).left(channels.calibration), rel=1e-6)
    # All but the common rotation.
    assert base.rank == base.calibration_rank == 12 * sensors - 3


def test_the_gain_of_an_effect_is_that_of_least_squares(made, dense):
    """All terms together, each alone, and some with others eliminated."""
    channels, truth = made.channels(), dense(made)
    calibration = channels.calibration
    base = Base(channels, [calibration])
    terms = drift_terms(channels)
    projected = base.project(Regressors.of(terms))
    gain, rank = projected.gain()
    assert rank == len(terms)
    assert gain == pytest.approx(base.energy - truth.left(calibration, Regressors.of(terms)), rel=1e-5)
    gains, ranks = projected.gains(columns_of(terms))
    assert (ranks == 1).all()
    for term, own in zip(terms, gains, strict=True):
        assert own == pytest.approx(base.energy - truth.left(calibration, Regressors.of([term])), rel=1e-4, abs=1e-3)
    first, second = np.arange(4), np.arange(4, len(terms))
    apart = projected.without(first)
    assert apart.gains([second])[0][0] == pytest.approx(gain - projected.take(first).gain()[0], rel=1e-6)
    assert apart.gains([first])[0][0] == pytest.approx(0, abs=1e-6 * gain)


def test_what_the_calibration_holds_is_dropped_and_not_counted(made):
    """A constant offset and a scale factor are directions of the calibration: no gain, no rank, alone or beside."""
    channels = made.channels()
    base = Base(channels, [channels.calibration])
    constant = Regressors(np.full((200, 1), 1e-9), np.array([0]), np.array([4]), np.array([0]), 1)
    scale = Regressors(channels.covariates.sensed_T[:, [4]], np.array([0]), np.array([4]), np.array([0]), 1)
    for design in (constant, scale):
        projected = base.project(design)
        assert projected.gain() == (0.0, 0)
        gains, ranks = projected.gains([np.array([0])])
        assert gains[0] == 0 and ranks[0] == 0
    drift = Regressors.of(drift_terms(channels))
    alone, beside = base.project(drift).gain(), base.project(Regressors.joined([drift, constant, scale])).gain()
    assert beside[1] == alone[1] and beside[0] == pytest.approx(alone[0], rel=1e-4)


def test_a_column_twice_is_counted_once(made):
    """Terms that say the same spend one direction."""
    channels = made.channels()
    base = Base(channels, [channels.calibration])
    drift = Regressors.of(drift_terms(channels))
    once, twice = base.project(drift).gain(), base.project(Regressors.joined([drift, drift])).gain()
    assert twice[1] == once[1] and twice[0] == pytest.approx(once[0], rel=1e-6)


def test_an_extended_base_is_the_base_of_both(made, dense):
    """What was accepted is eliminated with the calibration."""
    channels = made.channels()
    calibration, drift = channels.calibration, Regressors.of(drift_terms(channels))
    curves = Regressors.of(list(Nonlinearity().terms(channels.covariates, {"full_scale_T": 5e-5}))[:3])
    base = Base(channels, [calibration])
    extended = Base(channels, [calibration, drift])
    assert extended.rank == base.rank + drift.width and extended.calibration_rank == base.rank
    assert extended.energy == pytest.approx(base.energy - base.project(drift).gain()[0], rel=1e-6)
    assert extended.energy == pytest.approx(dense(made).left(calibration, drift), rel=1e-6)
    left = dense(made).left(calibration, drift, curves)
    assert extended.project(curves).gain()[0] == pytest.approx(extended.energy - left, rel=1e-3)


def test_the_step_is_the_least_squares_solution(made, dense):
    """The energy falls by what the step says, and no column is left with a score."""
    channels = made.channels()
    designs = [channels.calibration, Regressors.of(drift_terms(channels))]
    base = Base(channels, designs)
    matrix = np.concatenate([dense(made).of(design) for design in designs], axis=2).reshape(-1, len(base.step))
    left = dense(made).residual.ravel() - matrix @ base.step
    assert left @ left == pytest.approx(base.energy, rel=1e-6)
    assert_allclose(matrix.T @ left / np.linalg.norm(matrix, axis=0), 0, atol=1e-3)


def test_the_likelihood_ratio_is_of_a_free_scale():
    """It is n ln of the ratio of the energies, and stays finite where all is explained."""
    assert twice_log_likelihood_ratio(200.0, 50.0, 100.0) == pytest.approx(100 * log(200 / 150))
    assert twice_log_likelihood_ratio(200.0, 0.0, 100.0) == 0
    assert twice_log_likelihood_ratio(200.0, 200.0, 100.0) == pytest.approx(100 * log(1e9))


def test_a_column_without_information_is_no_direction():
    """A feature that is zero everywhere gains nothing, divides by nothing, and gets a coefficient of zero."""
    projected = Projected(np.diag([4.0, 0.0]), np.array([2.0, 0.0]), np.array([4.0, 0.0]))
    assert projected.gain() == (1.0, 1)
    gains, ranks = projected.gains([np.array([0]), np.array([1]), np.array([0, 1])])
    assert_allclose(gains, [1, 0, 1])
    assert ranks.tolist() == [1, 0, 1]
