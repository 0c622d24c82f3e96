"""The page says what departs from the twin, in which axes, and that nothing does where nothing does."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.gap.checks import checks_of
from tam_calibration.report.gap_checks import checks_section, plot_autocorrelation
from tam_calibration.report.gap_view import GapView


def view_of(gap, rows_T):
    """Return a gap whose checks are those of a residual."""
    residue = gap.residue
    checks = checks_of(residue.time_s, residue.direction, rows_T, residue.floor_T)
    return GapView(replace(gap, checks=checks))


def test_without_checks_there_is_no_section(gap):
    """As without a verdict."""
    assert checks_section(GapView(gap)) == []


def test_what_looks_like_the_twin_is_said_to(gap):
    """A sentence, and the figure."""
    noise = np.random.default_rng(1).normal(size=gap.residue.before.shape) * gap.residue.floor_T
    (section,) = checks_section(view_of(gap, noise))
    assert "and so it does" in section.blocks[0].text and len(section.blocks) == 3


def test_what_departs_is_in_the_table(gap):
    """The rows of sensor 2, which drifts, with marks where they are above the range of noise."""
    (section,) = checks_section(view_of(gap, gap.residue.before))
    table = section.blocks[2]
    assert [row[0] for row in table.rows] == ["noise alone", "sensor 2 x", "sensor 2 y", "sensor 2 z"]
    assert all(row[1].endswith("▲") and row[2].endswith("▲") for row in table.rows[1:])
    assert any("alike from sample to sample" in point for point in section.blocks[1].points)


def test_the_bars_are_the_autocorrelation(gap):
    """One a lag, and the band of noise beside them."""
    checks = view_of(gap, gap.residue.before).gap.checks
    axes = plot_autocorrelation(checks, 3).axes[0]
    heights = [patch.get_height() for patch in axes.patches if patch.get_width() == 0.5]
    assert_allclose(heights, checks.autocorrelation[3])
    assert np.mean(heights) == pytest.approx(0.9, abs=0.1)
