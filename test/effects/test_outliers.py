"""Spikes in single readings: found where they are, and nothing else taken for them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.fitted import ALL, SCALAR, Contribution
from tam_calibration.effects.outliers import Outliers
from tam_calibration.effects.saturation import Saturation

OUTLIERS = Outliers()


def spikes(sensor, axis=None, rate=0.02, size=9e-9, burst=1.0):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "spikes", {"rate": rate, "size": size, "burst": burst})


def evidence(finding, misfit):
    """Return how much BIC speaks for a finding."""
    return finding.gain - finding.parameter_count * np.log(misfit.channel_count.sum())


@pytest.mark.parametrize(("samples", "sensors"), [(60, 4), (400, 2), (2000, 4), (500, 12), (2000, 1)])
@pytest.mark.parametrize("has_scalar", [True, False])
def test_noise_has_no_outliers(bench, samples, sensors, has_scalar):
    """In ten records of noise alone, with data sheets wrong either way, no evidence for spikes is found."""
    for seed in range(10):
        made = bench(samples, sensors, has_scalar, moves=seed % 2 == 0, seed=seed, sheet=0.88 if seed < 5 else 1.12)
        misfit = made.misfit()
        found = OUTLIERS.find(misfit)
        assert isinstance(found, str) or evidence(found, misfit) < 0


@pytest.mark.parametrize(("sensor", "axis"), [(2, 1), (0, None), (SCALAR, None), (ALL, None)])
@pytest.mark.parametrize("burst", [1.0, 4.0])
def test_spikes_are_found_where_they_are(bench, sensor, axis, burst):
    """Sensor and axis, the samples and the size come out; hardly any other sample is flagged."""
    made = bench()
    struck = made.with_effect(OUTLIERS, spikes(sensor, axis, burst=burst))
    misfit = struck.misfit()
    found = OUTLIERS.find(misfit)
    assert [(part.sensor, part.axis) for part in found.fitted.contributions] == [(sensor, axis)]
    assert evidence(found, misfit) > 100
    size = np.abs(struck.rows_T - made.rows_T).max(axis=1)
    large = size > (8e-9 if sensor != SCALAR else 4e-9)
    assert found.flagged[large].mean() > 0.9
    assert found.flagged[size == 0].mean() < 0.002
    assert 0.2 < found.fitted.contributions[0].values["size"] / 9e-9 < 2.5


@pytest.mark.parametrize("burst", [9, 40])
def test_what_lasts_is_no_spike(bench, burst):
    """A bias that is off for some samples is left to other effects."""
    made = bench()
    rows = made.rows_T.copy()
    rows[700 : 700 + burst, 4] += 20e-9
    assert "longer than 8 samples" in OUTLIERS.find(made.with_rows(rows).misfit())


def test_a_noisy_axis_has_no_spikes(bench):
    """Gaussian noise of four times the size, throughout or for a while, is no spike."""
    made = bench()
    loud = np.random.default_rng(5).normal(0, 4e-9, 2000)
    for while_loud in (slice(None), slice(300, 900)):
        rows = made.rows_T.copy()
        rows[while_loud, 4] += loud[while_loud]
        assert isinstance(OUTLIERS.find(made.with_rows(rows).misfit()), str)


def test_what_follows_the_direction_is_no_spike(bench):
    """A sensor that errs at a few attitudes, met at random times, has no spikes: neighbouring attitudes err as well."""
    made = bench(moves=False)
    rows = made.rows_T.copy()
    direction = made.situation.field_T[:, 0] / made.situation.intensity_T
    rows[:, 4] += 40e-9 * np.exp(-(((direction - 1) / 0.2) ** 2))
    found = OUTLIERS.find(made.with_rows(rows).misfit())
    assert isinstance(found, str)


def test_readings_at_a_limit_are_no_spikes(bench):
    """An axis that is cut off has no outliers."""
    made = bench()
    limit = float(np.quantile(made.rows_T[:, 5], 0.99))
    cut = made.with_effect(Saturation(), Contribution(1, 2, "limit", {"upper limit": limit}))
    assert isinstance(OUTLIERS.find(cut.misfit()), str)


def test_found_again_when_left_out(bench):
    """Once its samples do not count they are found as before, with the same gain."""
    struck = bench().with_effect(OUTLIERS, spikes(1, 0))
    first = OUTLIERS.find(struck.misfit())
    again = OUTLIERS.find(struck.misfit(is_counted=~first.flagged))
    assert (again.flagged == first.flagged).all()
    assert_allclose(again.gain, first.gain)


def test_a_lone_spike_costs_about_two_parameters(bench):
    """One position and one value; many of them cost less each."""
    made = bench(4000)
    rows = made.rows_T.copy()
    rows[1234, 7] += 30e-9
    lone = OUTLIERS.find(made.with_rows(rows).misfit())
    assert lone.flagged.nonzero()[0].tolist() == [1234] and lone.parameter_count in (3, 4)
    many = OUTLIERS.find(made.with_effect(OUTLIERS, spikes(1, 0, rate=0.05)).misfit())
    assert many.parameter_count < 1.7 * many.flagged.sum()


def test_samples_without_reference_are_no_obstacle(bench):
    """A scalar magnetometer that reads every third sample is enough."""
    struck = bench().with_effect(OUTLIERS, spikes(3, 2))
    rows = struck.rows_T.copy()
    rows[np.arange(2000) % 3 > 0, -1] = np.nan
    found = OUTLIERS.find(struck.with_rows(rows).misfit())
    assert [(part.sensor, part.axis) for part in found.fitted.contributions] == [(3, 2)]


def test_too_few_samples_are_told(bench):
    """A dozen samples tell nothing."""
    assert "too few samples" in OUTLIERS.find(bench(12).misfit())


def test_added_spikes_have_the_stated_rate_and_size(bench):
    """In simulations they come at random times, in bursts of the stated length."""
    made = bench(20_000)
    change = made.with_effect(OUTLIERS, spikes(1, 2, rate=0.03, size=7e-9, burst=3.0)).rows_T - made.rows_T
    struck = change[:, 5] != 0
    assert_allclose(struck.mean(), 0.03, rtol=0.15)
    assert_allclose(change[struck, 5].std(), 7e-9, rtol=0.1)
    assert_allclose(struck.sum() / np.sum(np.diff(struck.astype(int)) == 1), 3, rtol=0.1)
    assert not change[:, np.arange(13) != 5].any()


def test_spikes_that_come_with_the_motion_are_none(bench):
    """What rings after each change of the pose is no spike of the electronics."""
    made = bench(moves=False)
    rows, count = made.rows_T.copy(), len(made.rows_T)
    field = made.situation.field_T
    change = np.linalg.norm(field[2:] - field[:-2], axis=1)
    rows[1 + np.argsort(change)[-20:], 4] += 80e-9
    assert "where the field changes most" in OUTLIERS.find(made.with_rows(rows).misfit())
    anywhere = np.random.default_rng(2).choice(count, 20, replace=False)
    rows = made.rows_T.copy()
    rows[anywhere, 4] += 80e-9
    assert not isinstance(OUTLIERS.find(made.with_rows(rows).misfit()), str)


@pytest.mark.parametrize(("lowest", "comes_with_motion"), [(0.32, False), (0.64, True)])
def test_spikes_come_with_the_motion_from_some_rank_on(bench, lowest, comes_with_motion):
    """Twenty among the upper two thirds of the changes lie two and a half deviations high, in the upper third five."""
    made = bench(moves=False)
    rows, field = made.rows_T.copy(), made.situation.field_T
    order = np.argsort(np.linalg.norm(field[2:] - field[:-2], axis=1))
    rows[1 + order[np.linspace(lowest * len(order), len(order) - 1, 20).astype(int)], 4] += 80e-9
    found = OUTLIERS.find(made.with_rows(rows).misfit())
    assert (found == "the spikes come where the field changes most") == comes_with_motion
