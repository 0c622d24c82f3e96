"""Spikes in single readings: found where they are, and nothing else taken for them."""

import numpy as np
import pytest
from findings import evidence
from numpy.testing import assert_allclose

from tam_calibration.effects.single_samples import Outliers, find_spikes
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution

OUTLIERS = Outliers()


def spikes(sensor, axis=None, rate=0.02, size=9e-9, burst=1.0):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "spikes", {"rate": rate, "size": size, "burst": burst})


@pytest.mark.parametrize(("sensor", "axis"), [(2, 1), (0, None), (SCALAR, None), (ALL, None)])
@pytest.mark.parametrize("burst", [1.0, 4.0])
def test_spikes_are_found_where_they_are(bench, sensor, axis, burst):
    """Sensor and axis, the samples and the size come out; hardly any other sample is flagged."""
    made = bench()
    struck = made.with_effect(OUTLIERS, spikes(sensor, axis, burst=burst))
    residuals = struck.residuals()
    found = OUTLIERS.find(residuals)
    assert [(part.sensor, part.axis) for part in found.fitted.contributions] == [(sensor, axis)]
    assert evidence(found, residuals) > 100
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
    assert "for at most 8 samples" in OUTLIERS.find(made.with_rows(rows).residuals())


def test_a_noisy_axis_has_no_spikes(bench):
    """Gaussian noise of four times the size, throughout or for a while, is no spike."""
    made = bench()
    loud = np.random.default_rng(5).normal(0, 4e-9, 2000)
    for while_loud in (slice(None), slice(300, 900)):
        rows = made.rows_T.copy()
        rows[while_loud, 4] += loud[while_loud]
        assert isinstance(OUTLIERS.find(made.with_rows(rows).residuals()), str)


def test_found_again_when_left_out(bench):
    """Once its samples do not count they are found as before, with the same gain."""
    struck = bench().with_effect(OUTLIERS, spikes(1, 0))
    first = OUTLIERS.find(struck.residuals())
    again = OUTLIERS.find(struck.residuals(is_counted=~first.flagged))
    assert (again.flagged == first.flagged).all()
    assert_allclose(again.gain, first.gain)


def test_a_lone_spike_costs_about_two_parameters(bench):
    """One position and one value; many of them cost less each."""
    made = bench(4000)
    rows = made.rows_T.copy()
    rows[1234, 7] += 30e-9
    lone = OUTLIERS.find(made.with_rows(rows).residuals())
    assert lone.flagged.nonzero()[0].tolist() == [1234] and lone.parameter_count in (3, 4)
    many = OUTLIERS.find(made.with_effect(OUTLIERS, spikes(1, 0, rate=0.05)).residuals())
    assert many.parameter_count < 1.7 * many.flagged.sum()


def test_samples_without_reference_are_no_obstacle(bench):
    """A scalar magnetometer that reads every third sample is enough."""
    struck = bench().with_effect(OUTLIERS, spikes(3, 2))
    rows = struck.rows_T.copy()
    rows[np.arange(2000) % 3 > 0, -1] = np.nan
    found = OUTLIERS.find(struck.with_rows(rows).residuals())
    assert [(part.sensor, part.axis) for part in found.fitted.contributions] == [(3, 2)]


def test_added_spikes_have_the_stated_rate_and_size(bench):
    """In simulations they come at random times, in bursts of the stated length."""
    made = bench(20_000)
    change = made.with_effect(OUTLIERS, spikes(1, 2, rate=0.03, size=7e-9, burst=3.0)).rows_T - made.rows_T
    struck = change[:, 5] != 0
    assert_allclose(struck.mean(), 0.03, rtol=0.15)
    assert_allclose(change[struck, 5].std(), 7e-9, rtol=0.1)
    assert_allclose(struck.sum() / np.sum(np.diff(struck.astype(int)) == 1), 3, rtol=0.1)
    assert not change[:, np.arange(13) != 5].any()


def shaped(made, deviations, row=4):
    """Return the residual of readings of a row of which some samples are off by so many standard errors."""
    residuals, rows = made.residuals(), made.rows_T.copy()
    errors = 1 / np.sqrt(residuals.row_information[:, row])
    for sample, size in deviations.items():
        rows[sample, row] += size * errors[sample] - residuals.row_shift_T[sample, row]
    return made.with_rows(rows).residuals()


@pytest.mark.parametrize(("part", "are_spikes"), [(0.07, True), (0.14, False)])
def test_less_than_a_tenth_of_the_samples_may_be_spikes(bench, part, are_spikes):
    """A seventh of them may not."""
    struck = np.random.default_rng(1).random(2000) < part
    deviations = {int(sample): 30 * (-1) ** int(sample) for sample in np.flatnonzero(struck)}
    assert ("too many" not in str(find_spikes(shaped(bench(moves=False), deviations)))) == are_spikes
