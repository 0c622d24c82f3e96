"""Interference at a fixed frequency."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.courses import PeriodicInterference, _lattice
from tam_calibration.model.fitted_effect import SCALAR, Contribution, FittedEffect

EFFECT = PeriodicInterference()
SHAPE = {"frequency_hz": 3.217, "start_s": 0.0}
LINE = {"cosine 1": 1e-9, "sine 1": -1e-9}


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


def test_a_hole_of_decades_has_no_spectrum(turning, left_by):
    """Two blocks 1e9 s apart; what is between them is not computed."""
    whole = turning(samples=1200)
    covariates = replace(whole, time_s=whole.time_s + 1e9 * (np.arange(1200) >= 600))
    assert EFFECT.shapes(covariates, left_by(EFFECT, covariates, SHAPE, (2, 0, "line", LINE))) == []


def test_the_phase_does_not_depend_on_the_epoch(turning):
    """Times of day of today make the same waves as times from zero."""
    late = EFFECT.terms(turning(start_s=1.7e9), {"frequency_hz": 3.0, "start_s": 1.7e9})[0].features
    assert_allclose(late, EFFECT.terms(turning(), {"frequency_hz": 3.0, "start_s": 0.0})[0].features, atol=1e-5)


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


@pytest.mark.parametrize(("overtone_T", "is_told"), [(1.3e-9, False), (1.6e-9, True)])
def test_harmonics_are_no_larger_than_the_line(turning, overtone_T, is_told):
    """A harmonic beyond half the sampling rate would be any drift."""
    parts = (Contribution(2, 0, "line", LINE), Contribution(0, 1, "harmonics", {"cosine 2": overtone_T}))
    sizes = EFFECT.sizes(turning(), FittedEffect(EFFECT.name, SHAPE, parts))
    assert ("harmonics over the line" in [sized.name for sized in sizes if not sized.is_natural]) == is_told
