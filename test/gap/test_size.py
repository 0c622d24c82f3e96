"""The size of a gap is that of the effect that was planted, as far as the channels can see it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from tam_calibration.effects.courses import GeomagneticDrift, TemperatureDrift
from tam_calibration.gap.laws.signature import laws_of
from tam_calibration.gap.laws.whitened import residual_of
from tam_calibration.gap.size import (
    FOLDS,
    _closed,
    folds_of,
    held_out_energy,
    is_interleaved,
    measure,
    noise_variance,
)
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

SHAPE = {"time_constant_s": 0.0, "reference_C": 20.0}


def drift(*rows):
    """Return an effect in some rows, without values yet."""
    parts = tuple(Contribution(*divmod(row, 3), "offset", {}) for row in rows)
    return FittedEffect("temperature_drift", SHAPE, parts)


def planted(made, slopes):
    """Return a run with axes that drift, by row in tesla per kelvin."""
    change = made.recording.temperature_C - 20
    for row, slope in slopes.items():
        made = made.with_row(row, slope * change)
    return made


def visible(made, dense, slopes):
    """Return the part of the signal's energy that no calibration takes up, for each channel."""
    channels, clean = made.channels(), dense(made)
    signal = planted(made, slopes).recording.readings_T - made.recording.readings_T
    rows = np.column_stack([signal.reshape(len(signal), -1), np.zeros(len(signal))])
    only = replace(clean, residual=np.einsum("ncr,nr->nc", clean.slope, rows))
    return only.left(channels.calibration) / channels.count


@pytest.mark.parametrize("slope", [1e-9, 4e-9, 20e-9])
def test_the_visible_gap_is_that_of_the_planted_effect(run, dense, slope):
    """In noise floors, within what the noise of n channels and the cross term allow."""
    made = run(1200)
    expected = visible(made, dense, {4: slope})
    model = planted(made, {4: slope}).model()
    size = measure(model, model, 1.0)
    deviation = np.sqrt((2 + 4 * expected) / model.base().channels.count)
    assert size.before**2 == pytest.approx(expected, abs=4 * deviation + 0.03 * expected)
    assert size.closed == 0 and size.after == size.before
    assert size.floor_T == pytest.approx(1e-9) and size.before_T == pytest.approx(size.before * 1e-9)


def test_the_gap_closes_when_its_effect_is_added(run, accepted):
    """What is left is noise, and nearly all is closed."""
    made = planted(run(1200), {4: 4e-9})
    nominal = made.model()
    model = accepted(nominal, TemperatureDrift(), drift(4))
    size = measure(nominal, model, 1.0)
    assert size.before > 1 and size.after < 0.2 and size.closed > 0.97
    assert size.closed_interval[0] <= size.closed <= size.closed_interval[1] <= 1
    assert size.before_T_per_m > 5 * size.after_T_per_m


def test_a_clean_run_has_no_size(run):
    """Over seeds the excess out of sample is as often below zero as above, and small."""
    sizes = [measure(model, model, 1.0).before for model in (run(600, seed=seed).model() for seed in range(20))]
    # The deviation of χ²/n of 6000 channels is 0.018; the root of three of them 0.23.
    assert max(sizes) < 0.25 and 4 <= sum(size == 0 for size in sizes) <= 16


def test_the_interval_of_what_closes_covers(run, dense, accepted):
    """Of two effects one is added: the interval holds the true part in nearly all of twelve runs."""
    slopes, held = {4: 4e-9, 6: 3e-9}, 0
    for seed in range(12):
        clean = run(900, seed=seed)
        made = planted(clean, slopes)
        nominal = made.model()
        model = accepted(nominal, TemperatureDrift(), drift(4))
        both, other = visible(clean, dense, slopes), model_leaves(clean, dense, slopes, model)
        low, high = measure(nominal, model, 1.0).closed_interval
        held += low <= 1 - other / both <= high
    # Of intervals that hold in 95 % of runs fewer than nine of twelve would do so in one case of five thousand.
    assert held >= 9


def test_the_interval_of_what_closes_is_students():
    """Where all folds have the same gap, the part that closes is a mean of five, with the interval of Student's t."""
    left = np.array([0.2, 0.26, 0.31, 0.22, 0.24])
    interval = stats.ttest_1samp(1 - left, 0).confidence_interval(0.95)
    closed, found = _closed(np.ones(5), left)
    assert closed == pytest.approx(1 - left.mean()) and found == pytest.approx(tuple(interval))


@pytest.mark.parametrize(("before", "left", "interval"), [(1.0, -0.1, (1, 1)), (1.0, 3.0, (0, 0)), (-1.0, 0.5, (0, 0))])
def test_what_closes_is_a_part(before, left, interval):
    """Of a gap that noise has overdone, that a cause has widened, or that is none: all of it, or nothing."""
    assert _closed(np.full(5, before), np.full(5, left)) == (interval[0], interval)


@pytest.mark.parametrize(("left", "end", "at"), [(0.01, 1, 1.0), (0.99, 0, 0.0)])
def test_the_interval_of_what_closes_ends_at_nothing_and_all(left, end, at):
    """However the folds scatter."""
    closed, interval = _closed(np.ones(5), left + np.array([-0.02, 0.02, 0.0, 0.01, -0.01]))
    assert closed == pytest.approx(1 - left) and interval[end] == at and interval[1 - end] != pytest.approx(closed)


def model_leaves(made, dense, slopes, model):
    """Return the part of the signal's energy that neither the calibration nor the model's effect takes up."""
    channels, clean = made.channels(), dense(made)
    signal = planted(made, slopes).recording.readings_T - made.recording.readings_T
    rows = np.column_stack([signal.reshape(len(signal), -1), np.zeros(len(signal))])
    only = replace(clean, residual=np.einsum("ncr,nr->nc", clean.slope, rows))
    design = channels.design(model.parts[0].terms(channels))
    return only.left(channels.calibration, design) / channels.count


@pytest.mark.parametrize(("sheet", "expected"), [(0.85, 0.85), (1.0, 1.0), (1.12, 1.12), (1.5, 1.2)])
def test_the_floor_is_that_of_the_data_up_to_a_fifth_above_the_sheet(run, sheet, expected):
    """White noise common to all is the floor; what exceeds the sheet by more is gap."""
    model = run(1200, sheet=sheet).model()
    variance = noise_variance(model, ())
    assert np.sqrt(variance) == pytest.approx(expected, abs=0.03)
    size = measure(model, model, variance)
    assert size.floor_T == pytest.approx(expected / sheet * 1e-9, rel=0.03)
    assert (size.before > 0.5) == (sheet > expected)


def test_what_a_law_explains_is_not_noise(run):
    """A slow drift without a cause does not raise the floor."""
    made = run(900)
    model = made.with_row(4, 8e-9 * np.cos(np.pi * np.linspace(0, 1, 900) * 3)).model()
    residual = residual_of(model)
    laws = laws_of(residual, residual.excess)
    with_drift, floor = noise_variance(model, ()), noise_variance(model, laws)
    assert with_drift == pytest.approx(1.44) and floor == pytest.approx(1, abs=0.08)


@pytest.mark.parametrize(("is_determined", "least"), [(True, 0.8), (False, 0.2)])
def test_no_law_explains_noise_away(run, monkeypatch, is_determined, least):
    """Four fifths of what differences tell are noise, or of half the stated deviation, where differences tell none."""
    made = run(900)
    model = made.model()
    level = np.append(made.array.vector_noise_T.repeat(3), np.nan)
    floor = SimpleNamespace(is_determined=is_determined, level_T=level, stated_T=level)
    monkeypatch.setattr("tam_calibration.gap.size.floor_of", lambda channels, stated: floor)
    assert noise_variance(model, (SimpleNamespace(part=1.0),)) == pytest.approx(least, rel=1e-9)


def test_free_functions_of_time_are_tested_on_interleaved_samples(run, accepted):
    """Blocks of time would tell nothing of them."""
    model = run(300).model()
    assert not is_interleaved(model)
    parts = (Contribution(-1, None, "orders 3 to 4", {}),)
    effect = GeomagneticDrift()
    (shape,) = effect.shapes(model.base().channels.covariates, None)
    (name,) = {term.name for term in effect.terms(model.base().channels.covariates, shape)[:1]}
    fitted = FittedEffect(effect.name, shape, (replace(parts[0], term=name),))
    assert is_interleaved(accepted(model, effect, fitted))


def test_an_array_without_gradient_has_none(run):
    """Two sensors determine no tensor."""
    made = run(300, 2)
    model = made.model()
    size = measure(model, model, 1.0)
    assert np.isnan(size.before_T_per_m) and np.isfinite(size.before_T)


def test_the_tensor_of_a_clean_run_is_noise(run):
    """Its excess is far below the noise of one sample; that of an axis that is off by 100 nT at times is not."""
    made = run(900)
    one_sample = np.sqrt(np.sum((Array.cross(0.5).operator[3:8] ** 2).sum(axis=1))) * 1e-9
    model = made.model()
    assert measure(model, model, 1.0).before_T_per_m < 0.4 * one_sample
    is_off = np.arange(900) % 3 == 0
    model = made.with_row(1, 100e-9 * is_off).model()
    # The mean is taken up by the bias; gxy of the cross sees an axis through half the baseline, twice, halved.
    assert_allclose(measure(model, model, 1.0).before_T_per_m, 100e-9 * np.sqrt(2 / 9) / 0.5 / 2, rtol=0.15)


@pytest.mark.parametrize("interleaved", [True, False])
@pytest.mark.parametrize("count", [7, 59, 300, 1001])
def test_folds_are_a_partition(count, interleaved):
    """Each sample is in one fold; the folds are alike in size."""
    folds = [np.concatenate([np.arange(count)[block] for block in fold]) for fold in folds_of(count, interleaved)]
    assert len(folds) == FOLDS
    assert sorted(np.concatenate(folds).tolist()) == list(range(count))
    if count >= 300:
        assert max(map(len, folds)) - min(map(len, folds)) <= 12


def test_blocks_are_contiguous_and_interleaved_samples_are_apart():
    """Free functions of time are not tested on stretches that no sample tells of."""
    assert all((np.diff(np.arange(600)[block]) == 1).all() for fold in folds_of(600, False) for block in fold)
    assert all((np.diff(np.arange(600)[block]) == FOLDS).all() for fold in folds_of(600, True) for block in fold)


@pytest.mark.parametrize("interleaved", [True, False])
def test_held_out_energy_is_that_of_explicit_fits(run, dense, interleaved):
    """For the calibration alone and with effects, samples that do not count left out."""
    made = run(240, 2)
    made = made.with_row(4, 5e-9 * (made.recording.temperature_C - 20))
    counted = np.random.default_rng(1).random(240) > 0.1
    channels, truth = made.channels(is_counted=counted), dense(made)
    shape = {"time_constant_s": 0.0, "reference_C": 20.0}
    terms = [one for one in TemperatureDrift().terms(channels.covariates, shape) if one.name == "offset"]
    designs = [channels.calibration, channels.design(terms[:4]), channels.design(terms[4:])]
    energy = np.transpose([held_out_energy(channels, designs[:count], interleaved) for count in (1, 2, 3)])
    whole = np.concatenate([truth.of(design) for design in designs], axis=2)
    ends = np.cumsum([design.width for design in designs])
    for row, fold in enumerate(folds_of(240, interleaved)):
        is_test = np.zeros(240, dtype=bool)
        for block in fold:
            is_test[block] = True
        for column, end in enumerate(ends):
            matrix, size = whole[:, :, :end], np.abs(whole[:, :, :end]).max(axis=(0, 1))
            train, test = counted & ~is_test, counted & is_test
            own = (matrix[train] / size).reshape(-1, end)
            step = np.linalg.lstsq(own, truth.residual[train].ravel(), rcond=1e-6)[0] / size
            expected = np.sum((truth.residual[test] - matrix[test] @ step) ** 2)
            assert energy[row, column] == pytest.approx(expected, rel=1e-3)


def test_a_planted_effect_lowers_it_and_noise_raises_it(run):
    """Out of sample an effect that is there explains, and one that is not there costs."""
    made = run(600)
    channels = made.with_row(4, 5e-9 * (made.recording.temperature_C - 20)).channels()
    shape = {"time_constant_s": 0.0, "reference_C": 20.0}
    terms = [one for one in TemperatureDrift().terms(channels.covariates, shape) if one.name == "offset"]
    designs = [channels.calibration, channels.design([terms[4]]), channels.design(terms[:4] + terms[5:])]
    alone, true, more = (held_out_energy(channels, designs[:count], False).sum() for count in (1, 2, 3))
    assert true < 0.2 * alone and more > true
    assert_allclose(true / channels.count, 1, atol=0.08)
