"""Energies out of sample are those of explicit fits to the other folds."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.temperature_drift import TemperatureDrift
from tam_calibration.gap.validation import FOLDS, folds_of, held_out_energy


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
    terms = [one for one in TemperatureDrift().terms(channels.situation, shape) if one.name == "offset"]
    designs = [channels.calibration, channels.design(terms[:4]), channels.design(terms[4:])]
    energy = held_out_energy(channels, designs, [1, 2, 3], interleaved)
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
    terms = [one for one in TemperatureDrift().terms(channels.situation, shape) if one.name == "offset"]
    designs = [channels.calibration, channels.design([terms[4]]), channels.design(terms[:4] + terms[5:])]
    alone, true, more = held_out_energy(channels, designs, [1, 2, 3], False).sum(axis=0)
    assert true < 0.2 * alone and more > true
    assert_allclose(true / channels.count, 1, atol=0.08)
