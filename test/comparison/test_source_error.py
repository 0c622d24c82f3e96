from dataclasses import replace

import pytest

from tam_calibration.comparison.compare import source_error, source_of


def test_a_source_in_a_clean_run_is_found_within_its_noise(side):
    """Its signal is some hundred times the noise: the median error is below a per cent of its distance of 2 m."""
    clean = side(1)
    found = source_error(clean.recording, clean, source_of(clean))
    low, high = found.interval_m
    assert 0 < low < found.median_m < high < 0.02


def test_an_effect_that_the_calibration_does_not_know_moves_the_source(side):
    """A drift of thirty nanoteslas in one sensor is a false gradient of tens of nT/m."""
    drifting = side(2, 3)
    source = source_of(drifting)
    moved, clean = (source_error(one.recording, one, source) for one in (drifting, side(1)))
    assert moved.interval_m[0] > 1.5 * clean.interval_m[1]


def test_without_attitude_no_source_is_located(side):
    """The regional field cannot be taken off: nothing is told."""
    clean = side(1)
    blind = replace(clean.recording, attitude=None)
    assert source_error(blind, clean, source_of(clean)) is None
    assert source_of(replace(clean, recording=blind)) is None


def test_the_source_is_as_far_as_its_array_asks(side):
    """Eight times the distance of the sensors: 2 m for the cross of half a metre."""
    source = source_of(side(1))
    assert (source.position_m**2).sum() ** 0.5 == pytest.approx(2.0, rel=1e-3)
