"""What a result tells of itself: how fast the array turned, what may stay unseen, and the verdict by name."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.gap.diagnose import too_short
from tam_calibration.gap.result import Gap, Residue


def residue_of(time_s, direction):
    """Return residuals of nothing."""
    nothing = np.full((len(time_s), 4), np.nan)
    return Residue(np.asarray(time_s), np.asarray(direction), nothing, nothing, nothing, np.full(4, np.nan))


def test_the_rate_is_the_angle_between_samples_over_their_time():
    """A quarter, a half and no turn; after the last sample there is none."""
    direction = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, -1.0, 0.0]])
    assert_allclose(residue_of([0.0, 0.5, 2.5, 2.75], direction).rate, [np.pi, np.pi / 2, 0.0, np.nan])


def test_the_largest_unseen_bias_grows_with_the_root_of_the_channels():
    """A gap of g noise floors in n channels shifts a parameter by g √n of its standard errors at most."""
    gap = SimpleNamespace(smallest_gap=0.2, channel_count=400.0)
    assert Gap.most_unseen_errors.fget(gap) == pytest.approx(4.0)


def test_the_verdict_stands_before_the_statement_once(run):
    """A statement that begins with it is not told twice."""
    gap = too_short(run(60).recording.take(slice(5)))
    assert gap.headline == f"Not identifiable: {gap.statement}"
    named = SimpleNamespace(verdict="no_gap", statement="No gap: what the calibration leaves is noise.")
    assert Gap.headline.fget(named) == named.statement


def test_a_result_is_shown_without_what_is_for_plots(run):
    """Residuals and checks have as many lines as samples."""
    shown = repr(too_short(run(60).recording.take(slice(5))))
    assert "not_identifiable" in shown and "residue" not in shown and "checks" not in shown
