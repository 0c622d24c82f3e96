"""Spikes in single readings: found where they are, and nothing else taken for them."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.outliers import Outliers
from tam_calibration.effects.saturation import Saturation
from tam_calibration.effects.spikes import _chance, _improbable, _is_loud_around, find_spikes
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution

OUTLIERS = Outliers()


def spikes(sensor, axis=None, rate=0.02, size=9e-9, burst=1.0):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "spikes", {"rate": rate, "size": size, "burst": burst})


def evidence(finding, residuals):
    """Return how much BIC speaks for a finding."""
    return finding.gain - finding.parameter_count * np.log(residuals.channel_count.sum())


@pytest.mark.parametrize(("samples", "sensors"), [(60, 4), (400, 2), (2000, 4), (500, 12), (2000, 1)])
@pytest.mark.parametrize("has_scalar", [True, False])
def test_noise_has_no_outliers(bench, samples, sensors, has_scalar):
    """In ten records of noise alone, with data sheets wrong either way, no evidence for spikes is found."""
    for seed in range(10):
        made = bench(samples, sensors, has_scalar, moves=seed % 2 == 0, seed=seed, sheet=0.88 if seed < 5 else 1.12)
        residuals = made.residuals()
        found = OUTLIERS.find(residuals)
        assert isinstance(found, str) or evidence(found, residuals) < 0


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
    assert "longer than 8 samples" in OUTLIERS.find(made.with_rows(rows).residuals())


def test_a_noisy_axis_has_no_spikes(bench):
    """Gaussian noise of four times the size, throughout or for a while, is no spike."""
    made = bench()
    loud = np.random.default_rng(5).normal(0, 4e-9, 2000)
    for while_loud in (slice(None), slice(300, 900)):
        rows = made.rows_T.copy()
        rows[while_loud, 4] += loud[while_loud]
        assert isinstance(OUTLIERS.find(made.with_rows(rows).residuals()), str)


def test_what_follows_the_direction_is_no_spike(bench):
    """A sensor that errs at a few attitudes, met at random times, has no spikes: neighbouring attitudes err as well."""
    made = bench(moves=False)
    rows = made.rows_T.copy()
    direction = made.covariates.field_T[:, 0] / made.covariates.intensity_T
    rows[:, 4] += 40e-9 * np.exp(-(((direction - 1) / 0.2) ** 2))
    found = OUTLIERS.find(made.with_rows(rows).residuals())
    assert isinstance(found, str)


def test_readings_at_a_limit_are_no_spikes(bench):
    """An axis that is cut off has no outliers."""
    made = bench()
    limit = float(np.quantile(made.rows_T[:, 5], 0.99))
    cut = made.with_effect(Saturation(), Contribution(1, 2, "limit", {"upper limit": limit}))
    assert isinstance(OUTLIERS.find(cut.residuals()), str)


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


def test_too_few_samples_are_told(bench):
    """A dozen samples tell nothing."""
    assert "too few samples" in OUTLIERS.find(bench(12).residuals())


def test_added_spikes_have_the_stated_rate_and_size(bench):
    """In simulations they come at random times, in bursts of the stated length."""
    made = bench(20_000)
    change = made.with_effect(OUTLIERS, spikes(1, 2, rate=0.03, size=7e-9, burst=3.0)).rows_T - made.rows_T
    struck = change[:, 5] != 0
    assert_allclose(struck.mean(), 0.03, rtol=0.15)
    assert_allclose(change[struck, 5].std(), 7e-9, rtol=0.1)
    assert_allclose(struck.sum() / np.sum(np.diff(struck.astype(int)) == 1), 3, rtol=0.1)
    assert not change[:, np.arange(13) != 5].any()


def across(made, row):
    """Return how much a row should change from the sample before each to the one after, of all but the ends."""
    sensed = made.covariates.sensed_T[:, row]
    return np.abs(sensed[2:] - sensed[:-2])


@pytest.mark.parametrize("order", [1, -1])
def test_spikes_that_come_with_the_motion_are_none(bench, order):
    """What comes at the fastest changes of an axis, or where it stands still, is no spike of the electronics."""
    made = bench(moves=False)
    rows = made.rows_T.copy()
    rows[1 + np.argsort(order * across(made, 4))[-20:], 4] += 80e-9
    assert "where the field changes fastest, or where it stands still" in OUTLIERS.find(
        made.with_rows(rows).residuals()
    )
    anywhere = np.random.default_rng(2).choice(len(rows), 20, replace=False)
    rows = made.rows_T.copy()
    rows[anywhere, 4] += 80e-9
    assert not isinstance(OUTLIERS.find(made.with_rows(rows).residuals()), str)


@pytest.mark.parametrize(("place", "comes_with_motion"), [(10, True), (40, False), (-1, False)])
def test_one_spike_comes_with_the_motion_where_one_in_a_hundred_would(bench, place, comes_with_motion):
    """Of two thousand samples, one at the tenth fastest change does, one at the fortieth and one at the slowest not."""
    made = bench(moves=False)
    rows = made.rows_T.copy()
    rows[1 + np.argsort(-across(made, 4))[place], 4] += 80e-9
    assert isinstance(OUTLIERS.find(made.with_rows(rows).residuals()), str) == comes_with_motion


@pytest.mark.parametrize(("slowest", "stands_still"), [(0.1, True), (0.6, False)])
def test_spikes_where_an_axis_stands_still_must_be_several(bench, slowest, stands_still):
    """Six in the slowest tenth of the changes are no chance; six in the slower six tenths are."""
    made = bench(moves=False)
    rows, order = made.rows_T.copy(), np.argsort(across(made, 4))
    rows[1 + order[np.linspace(0, slowest * len(order), 6).astype(int)], 4] += 80e-9
    assert isinstance(OUTLIERS.find(made.with_rows(rows).residuals()), str) == stands_still


def shaped(made, deviations, row=4):
    """Return the residual of readings of a row of which some samples are off by so many standard errors."""
    residuals, rows = made.residuals(), made.rows_T.copy()
    errors = 1 / np.sqrt(residuals.row_information[:, row])
    for sample, size in deviations.items():
        rows[sample, row] += size * errors[sample] - residuals.row_shift_T[sample, row]
    return made.with_rows(rows).residuals()


def is_spike(residuals, sample=700):
    """Return whether a sample is found to stand alone."""
    found = find_spikes(residuals)
    return not isinstance(found, str) and sample in found.samples


@pytest.mark.parametrize(("beside", "stands_alone"), [(2.2, True), (4.2, False)])
def test_what_is_hot_beside_a_spike_is_of_its_burst(bench, beside, stands_alone):
    """Nine samples beyond three standard deviations make it longer than a burst, below they do not."""
    deviations = {700 + step: beside if step > 0 else 0.3 for step in range(-10, 10)} | {700: 20}
    assert is_spike(shaped(bench(moves=False), deviations)) == stands_alone


@pytest.mark.parametrize(("part", "are_spikes"), [(0.07, True), (0.14, False)])
def test_less_than_a_tenth_of_the_samples_may_be_spikes(bench, part, are_spikes):
    """A seventh of them may not."""
    struck = np.random.default_rng(1).random(2000) < part
    deviations = {int(sample): 30 * (-1) ** int(sample) for sample in np.flatnonzero(struck)}
    assert ("too many" not in str(find_spikes(shaped(bench(moves=False), deviations)))) == are_spikes


@pytest.mark.parametrize(("steps", "stands_alone"), [((-1, 1, 2), True), ((-3, -2, -1, 1, 2, 3), False)])
def test_eight_neighbours_in_time_tell_what_is_shared(bench, steps, stands_alone):
    """Three that are half as far off are a minority of them, six are none."""
    quiet = {700 + step: 0.5 * (-1) ** step for step in range(-12, 13)}
    deviations = quiet | {700 + step: 2.9 for step in steps} | {700: 6}
    assert is_spike(shaped(bench(moves=False), deviations)) == stands_alone


@pytest.mark.parametrize(("part", "stands_alone"), [(0.17, True), (0.35, False)])
def test_neighbours_share_less_than_a_quarter_of_a_spike(bench, part, stands_alone):
    """Four on either side that are off by a third of it have its cause."""
    deviations = {700 + step: 7 * part for step in range(-5, 6)} | {700: 7}
    assert is_spike(shaped(bench(moves=False), deviations)) == stands_alone


@pytest.mark.parametrize(("loud", "steps", "stands_alone"), [(1.6, 20, True), (3.2, 20, False), (3.2, 9, True)])
def test_a_spike_stands_out_of_either_side(bench, loud, steps, stands_alone):
    """By three and a half standard deviations of most of the twenty-five samples on the louder side."""
    deviations = {700 + step: 0.5 * (-1) ** step for step in range(-60, 61)}
    deviations |= {703 + step: loud * (-1) ** step for step in range(steps)} | {700: 12}
    assert is_spike(shaped(bench(moves=False), deviations)) == stands_alone


@pytest.mark.parametrize(("size", "is_loud"), [(0.95, False), (1.6, True)])
def test_what_is_beside_spikes_is_no_louder(size, is_loud):
    """By a tenth, and what chance does."""
    generator = np.random.default_rng(1)
    far = np.arange(4000) % 20 == 10
    deviation = np.where(np.arange(4000) % 20 == 10, 9.0, size * generator.normal(size=4000))[:, None]
    worst = np.zeros(4000, dtype=int)
    assert _is_loud_around(deviation, worst, far, np.ones(4000, dtype=bool)) == is_loud


@pytest.mark.parametrize(("chance", "is_far"), [(0.7e-5, True), (1.4e-5, False)])
def test_one_of_a_thousand_samples_is_improbable(chance, is_far):
    """One in a hundred of what is told may be noise: of a single one its chance is a hundredth of a thousandth."""
    chances = np.full(1000, 0.5)
    chances[300] = chance
    assert np.flatnonzero(_improbable(chances)).tolist() == ([300] if is_far else [])


def test_the_chance_holds_that_the_scale_is_a_median_of_few():
    """In 200 samples of noise, over the scale that their median tells, four standard deviations are so probable."""
    drawn = np.random.default_rng(1).normal(size=(10_000, 200))
    probable = np.mean(2 * norm.sf(4 * noise_deviation(drawn, axis=1)))
    assert _chance(np.array([4.0]), 10_000, 1)[0] == pytest.approx(probable, rel=0.15)
