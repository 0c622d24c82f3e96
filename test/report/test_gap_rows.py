"""What the evidence means is said with its figures, and nothing is said where nothing is known."""

from dataclasses import replace

import pytest

from tam_calibration.effects.effect import Limit, Sized
from tam_calibration.report.gap_rows import cause_words, set_words, unseen_words


def test_a_cause_that_any_drift_resembles_says_so(gap):
    """Where its channel only rises or falls."""
    (words,) = cause_words(replace(gap.causes[0], is_drift=True))
    assert "any other slow drift explains as much" in words
    assert cause_words(gap.causes[0]) == []


def test_the_size_stands_beside_the_largest_known(gap):
    """In the units of reports, with the source; a ratio has none."""
    limits = Sized("offset", -2.5e-8, Limit(1e-6, "a book", "T")), Sized("bleed", 0.02, Limit(1.0, "another"))
    assert cause_words(replace(gap.causes[0], sizes=limits)) == [
        "Its offset is 25.0 nT; the largest known is 1000 nT (a book).",
        "Its bleed is 0.0200; the largest known is 1.00 (another).",
    ]


def test_the_set_that_holds_the_truth_is_told(gap):
    """Its names as people read them."""
    assert set_words(gap) == []
    told = replace(gap, set_95=("bias_jump", "eddy_current", "unknown"))
    assert set_words(told) == ["In 95 of 100 such recordings the truth is among: bias jump, eddy current and unknown."]


def test_an_unseen_gap_has_its_bound(gap):
    """0.1 noise floors over 10 000 values are 10 standard errors at most; only without a gap."""
    told = replace(gap, verdict="no_gap", smallest_gap=0.1, channel_count=10_000.0)
    (words,) = unseen_words(told)
    assert words.startswith("A gap of less than 0.10 noise floors") and "by 10 of its standard errors" in words
    assert told.most_unseen_errors == pytest.approx(10)
    assert (
        unseen_words(replace(told, verdict="explained")) == unseen_words(replace(told, smallest_gap=float("nan"))) == []
    )
