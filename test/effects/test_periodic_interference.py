"""Interference at a fixed frequency."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects import periodic_interference
from tam_calibration.effects.periodic_interference import PeriodicInterference, _lattice, _motion_band
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect

EFFECT = PeriodicInterference()
SHAPE = {"frequency_hz": 3.217, "start_s": 0.0}
LINE = {"cosine 1": 1e-9, "sine 1": -1e-9}


def test_coefficients_come_back(turning, refitted):
    """Lines and harmonics of an axis and of the scalar are told from the calibration."""
    keys = (0, 0, "line"), (0, 0, "harmonics"), (SCALAR, None, "line")
    deviation, error = refitted(EFFECT, turning(), SHAPE, *keys)
    assert np.abs(deviation).max() < 4
    assert error.max() < 0.1


@pytest.mark.parametrize("kind", ["even", "holes", "odd holes", "uneven"])
@pytest.mark.parametrize("where", [(2, 0), (SCALAR, None)])
def test_a_line_of_the_size_of_the_noise_is_found(turning, left_by, kind, where):
    """Its frequency is among those tried, to a small part of the width of a line, in records with holes too."""
    finer = turning(samples=24_000, step_s=0.005)
    steps = np.full(2200, 10)
    if kind == "holes":
        steps[[500, 900]] = 600
    elif kind == "odd holes":
        steps[[500, 900]] = 613, 607
    elif kind == "uneven":
        steps = np.random.default_rng(3).integers(8, 13, 2200)
    covariates = finer.take(np.cumsum(steps))
    residuals = left_by(EFFECT, covariates, SHAPE, (*where, "line", LINE))
    tried = [shape["frequency_hz"] for shape in EFFECT.shapes(covariates, residuals)]
    assert len(tried) <= 4
    assert np.abs(np.array(tried) - 3.217).min() < 0.1 / np.ptp(covariates.time_s)


@pytest.mark.parametrize("where", [(2, 0), (SCALAR, None)])
def test_a_line_is_found_through_many_holes(turning, left_by, where, monkeypatch):
    """Where holes are most of the record its frequency is as exact as its length allows."""
    monkeypatch.setattr(periodic_interference, "_MOST_STEPS", 10_000)
    finer = turning(samples=24_000, step_s=0.05)
    starts = 1000 * np.arange(24) + np.random.default_rng(3).integers(0, 900, 24)
    covariates = finer.take((starts[:, None] + np.arange(100)).ravel())
    residuals = left_by(EFFECT, covariates, SHAPE, (*where, "line", LINE))
    tried = [shape["frequency_hz"] for shape in EFFECT.shapes(covariates, residuals)]
    assert np.abs(np.array(tried) - 3.217).min() < 0.1 / np.ptp(covariates.time_s)


def test_a_hole_of_decades_costs_no_memory(turning, left_by):
    """Two blocks 1e9 s apart; what is between them is not computed."""
    whole = turning(samples=1200)
    covariates = replace(whole, time_s=whole.time_s + 1e9 * (np.arange(1200) >= 600))
    residuals = left_by(EFFECT, covariates, SHAPE, (2, 0, "line", LINE))
    tracemalloc.start()
    tried = [shape["frequency_hz"] for shape in EFFECT.shapes(covariates, residuals)]
    assert tracemalloc.get_traced_memory()[1] < 100e6
    tracemalloc.stop()
    assert np.abs(np.array(tried) - 3.217).min() < 1 / np.ptp(whole.time_s)


def test_lines_of_the_motion_are_not_proposed(turning, left_by):
    """What turns with the array is left to effects that depend on its attitude."""
    covariates = turning()
    residuals = left_by(EFFECT, covariates, {"frequency_hz": 0.1, "start_s": 0.0}, (1, 1, "line", {"cosine 1": 1e-7}))
    assert min(shape["frequency_hz"] for shape in EFFECT.shapes(covariates, residuals)) > 0.3


def test_the_phase_does_not_depend_on_the_epoch(turning):
    """Times of day of today make the same waves as times from zero."""
    late = EFFECT.terms(turning(start_s=1.7e9), {"frequency_hz": 3.0, "start_s": 1.7e9})[0].features
    assert_allclose(late, EFFECT.terms(turning(), {"frequency_hz": 3.0, "start_s": 0.0})[0].features, atol=1e-5)


def test_few_samples_show_nothing(turning):
    """A spectrum needs some samples."""
    assert "too few" in EFFECT.obstacle(turning(samples=20))


def test_some_thirty_samples_are_a_spectrum(turning):
    """More than two for each of ten periods."""
    assert EFFECT.obstacle(turning(samples=30)) is None


def test_all_of_four_lines_are_tried(turning, left_by):
    """Of which three may be harmonics that are stronger."""
    covariates, lines = turning(), (2.1, 3.217, 5.3, 7.9)
    residuals = left_by(EFFECT, covariates, SHAPE, (2, 0, "line", {"cosine 1": 2e-9}))
    for size, frequency in zip((6, 5, 4), (2.1, 5.3, 7.9), strict=True):
        wave = size * np.sin(2 * np.pi * frequency * covariates.time_s)
        residuals = replace(
            residuals, differential=residuals.differential + 1e-9 * wave[:, None] * residuals.directions[4]
        )
    tried = sorted(shape["frequency_hz"] for shape in EFFECT.shapes(covariates, residuals))
    assert_allclose(tried, lines, atol=0.01)


@pytest.mark.parametrize(("part", "is_even"), [(0.007, True), (0.014, False)])
def test_stamps_lie_on_a_lattice_to_a_hundredth_of_a_step(part, is_even):
    """What lies farther off is put on a lattice that is finer than the steps."""
    time = 0.1 * np.arange(500)
    time[250] += 0.1 * part
    place, spacing = _lattice(time, 0.1)
    assert (np.array_equal(place, np.arange(500)) and spacing == pytest.approx(0.1)) == is_even


@pytest.mark.parametrize(("part", "is_slow"), [(1.7e-3, True), (3.5e-3, False)])
def test_a_slight_part_of_the_amplitude_is_no_motion(turning, part, is_slow):
    """A swing of a tenth of a hertz with so much of another at 2 Hz."""
    covariates = turning()
    slow, fast = (np.sin(2 * np.pi * frequency * covariates.time_s) for frequency in (0.1, 2.0))
    field = 1e-6 * np.column_stack([slow + np.sqrt(part) * fast, np.ones((1200, 2))])
    band = _motion_band(replace(covariates, field_T=field))
    assert band == pytest.approx(0.15 if is_slow else 2.05, abs=0.06)


@pytest.mark.parametrize(("part", "is_beside"), [(0.2, True), (0.42, False)])
def test_motion_in_a_third_of_the_band_fills_it(turning, part, is_beside):
    """Then lines are sought in all of it."""
    covariates = turning()
    swing = np.sin(2 * np.pi * 10 * part * covariates.time_s)
    band = _motion_band(replace(covariates, field_T=1e-6 * np.column_stack([swing, np.ones((1200, 2))])))
    assert band == pytest.approx(10 * part if is_beside else 0, abs=0.1)


@pytest.mark.parametrize(("overtone_T", "is_told"), [(1.3e-9, False), (1.6e-9, True)])
def test_harmonics_are_no_larger_than_the_line(turning, overtone_T, is_told):
    """A harmonic beyond half the sampling rate would be any drift."""
    parts = (Contribution(2, 0, "line", LINE), Contribution(0, 1, "harmonics", {"cosine 2": overtone_T}))
    told = EFFECT.oversize(turning(), FittedEffect(EFFECT.name, SHAPE, parts))
    assert (told is not None and "harmonics over the line" in told) == is_told
