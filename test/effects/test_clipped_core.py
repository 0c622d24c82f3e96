"""Cores that are cut off in front of a factory correction."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.clipped_core import find_clipped_cores
from tam_calibration.effects.saturation import Saturation
from tam_calibration.model.fitted_effect import FittedEffect

MIXING = np.array([[1.0, 0.012, -0.008], [0.006, 1.02, 0.011], [-0.009, 0.004, 0.98]])
"""From what the cores see to what a sensor reads."""


def clipped(made, beyond, axis=1, follows=0.0, ends=(1, 1)):
    """Return the bench whose third sensor's core has so many samples beyond its limits, and which these are."""
    rows = made.rows_T.copy()
    core = made.covariates.sensed_T[:, 6:9] @ np.linalg.inv(MIXING).T
    height = np.where(core[:, axis] > 0, *ends) * np.abs(core[:, axis])
    limit = np.sort(height)[-beyond - 1]
    short = np.maximum(height - limit, 0) * np.sign(core[:, axis]) * (1 - follows)
    rows[:, 6:9] -= short[:, None] * MIXING[:, axis]
    return made.with_rows(rows), height > limit, limit


def roaming(bench, **options):
    """Return a bench whose array turns through all directions at random, as cores at their ends need it."""
    return bench(3000, moves=False, **options)


@pytest.mark.parametrize(("samples", "sensors"), [(60, 4), (2000, 4), (500, 12), (1000, 2)])
def test_noise_has_no_limit(bench, samples, sensors):
    """In motion and in poses, ten records each."""
    for seed in range(10):
        assert not find_clipped_cores(bench(samples, sensors, moves=seed % 2 == 0, seed=seed).residuals())


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("beyond", [15, 60])
@pytest.mark.parametrize("seed", [1, 2])
def test_a_clipped_core_is_found(bench, axis, beyond, seed):
    """Axis, both limits, the direction of the core and that of the shortfall come out, and the samples beyond."""
    made, struck, limit = clipped(roaming(bench, seed=seed), beyond, axis)
    (core,) = find_clipped_cores(made.residuals())
    assert (core.sensor, core.axis) == (2, axis)
    inverse = np.linalg.inv(MIXING)[axis]
    assert_allclose(core.direction, inverse / inverse[axis], atol=1e-3)
    assert_allclose(core.fall, MIXING[:, axis] * inverse[axis], atol=0.02)
    scaled = limit / inverse[axis]
    assert_allclose([core.limits_T["upper limit"], -core.limits_T["lower limit"]], scaled, rtol=2e-4)
    assert struck[core.samples].mean() > 0.9 and len(core.samples) > 0.8 * beyond


def test_a_limit_at_one_end(bench):
    """The end that no sample reaches has no limit."""
    made, struck, _ = clipped(roaming(bench), 20, ends=(1, 0))
    (core,) = find_clipped_cores(made.residuals())
    assert set(core.limits_T) == {"upper limit"} and struck[core.samples].mean() > 0.9


def test_five_samples_are_no_test_of_five_numbers(bench):
    """Four beyond the limits are too few, eight are enough."""
    assert not find_clipped_cores(clipped(roaming(bench), 4)[0].residuals())
    assert find_clipped_cores(clipped(roaming(bench), 8)[0].residuals())


@pytest.mark.parametrize(("follows", "is_found"), [(0.15, True), (0.25, False), (0.5, False)])
def test_a_core_that_goes_on_following_has_no_limit(bench, follows, is_found):
    """Up to a fifth of what lies beyond may come through."""
    assert bool(find_clipped_cores(clipped(roaming(bench), 40, follows=follows)[0].residuals())) == is_found


def test_a_bent_transfer_function_has_no_limit(bench):
    """Nor has a curve that loses sensitivity outwards, or what is off at the ends in any direction."""
    made = roaming(bench)
    rows = made.rows_T.copy()
    rows[:, 7] -= 200e-9 * (rows[:, 7] / 50e-6) ** 5
    assert not find_clipped_cores(made.with_rows(rows).residuals())
    rows, far = made.rows_T.copy(), np.abs(made.rows_T[:, 7]) > np.quantile(np.abs(made.rows_T[:, 7]), 0.99)
    rows[far, 7] -= np.sign(rows[far, 7]) * np.random.default_rng(3).uniform(0, 600e-9, far.sum())
    assert not find_clipped_cores(made.with_rows(rows).residuals())


def test_saturation_tells_it(bench):
    """It is found as such, its samples are given up, and a twin falls short in the same samples by as much."""
    plain = roaming(bench)
    made, struck, _ = clipped(plain, 40)
    found = Saturation().find(made.residuals())
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis, part.term) == (2, 1, "core limit")
    assert found.flagged[~struck].sum() <= 2
    twin = Saturation().add(plain.rows_T, plain.covariates, FittedEffect("saturation", {}, (part,)), None)
    missing, expected = (twin - plain.rows_T)[:, 6:9], (made.rows_T - plain.rows_T)[:, 6:9]
    assert_allclose(missing[struck], expected[struck], atol=0.03 * np.abs(expected).max())
    assert not (twin - plain.rows_T)[:, np.r_[0:6, 9:13]].any()


def test_one_sensor_alone_has_none(bench):
    """Nothing tells what it should read."""
    assert find_clipped_cores(bench(500, 1).residuals()) == []


@pytest.mark.parametrize(("depth", "ends"), [(2.4, {"upper limit", "lower limit"}), (4.5, {"upper limit"})])
def test_a_limit_is_sought_at_the_ends_of_the_range(bench, depth, ends):
    """What falls short twice as far in as the largest shortfall is one, what does so four times as far in is none."""
    made = roaming(bench)
    core = made.covariates.sensed_T[:, 6:9] @ np.linalg.inv(MIXING).T
    most = core[:, 1].max()
    largest = most - np.sort(core[:, 1])[-31]
    lowest = -most + (depth - 0.6) * largest
    made = replace(made, covariates=made.covariates.take(core[:, 1] > lowest), rows_T=made.rows_T[core[:, 1] > lowest])
    core = core[core[:, 1] > lowest, 1]
    short = np.maximum(core - most + largest, 0) + np.minimum(core + most - depth * largest, 0)
    rows = made.rows_T.copy()
    rows[:, 6:9] -= short[:, None] * MIXING[:, 1]
    (found,) = find_clipped_cores(made.with_rows(rows).residuals())
    assert set(found.limits_T) == ends
