"""Axes that cannot read beyond a limit."""

import numpy as np
import pytest
from findings import evidence
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.effects.converter import Saturation, find_limits
from tam_calibration.model.fitted_effect import ALL, Contribution

SATURATION = Saturation()


def limit(sensor, axis, **ends):
    """Return what the effect does to one axis: upper, lower in tesla."""
    return Contribution(sensor, axis, "limit", {f"{end} limit": value for end, value in ends.items()})


@pytest.mark.parametrize("part", [0.002, 0.02, 0.2])
@pytest.mark.parametrize("end", ["upper", "lower"])
def test_an_exact_limit_is_found(bench, part, end):
    """Every reading at the limit is flagged, and its value told, whether few or many are cut off."""
    made = bench()
    value = float(np.quantile(made.rows_T[:, 7], 1 - part if end == "upper" else part))
    residuals = made.with_effect(SATURATION, limit(2, 1, **{end: value})).residuals()
    found = SATURATION.find(residuals)
    (contribution,) = found.fitted.contributions
    assert (contribution.sensor, contribution.axis) == (2, 1)
    assert_allclose(contribution.values[f"{end} limit"], value, rtol=1e-12)
    beyond = made.rows_T[:, 7] >= value if end == "upper" else made.rows_T[:, 7] <= value
    assert_array_equal(found.flagged, beyond)
    assert evidence(found, residuals) > 20


def test_both_ends_and_several_axes(bench):
    """Each end of each axis is told."""
    made = bench()
    ends = {(0, 0): (-45e-6, 44e-6), (3, 2): (-40e-6, 46e-6)}
    parts = [limit(sensor, axis, lower=low, upper=high) for (sensor, axis), (low, high) in ends.items()]
    found = SATURATION.find(made.with_effect(SATURATION, *parts).residuals())
    told = {(part.sensor, part.axis): part.values for part in found.fitted.contributions}
    assert set(told) == set(ends) and found.parameter_count == 8
    for key, (low, high) in ends.items():
        assert_allclose([told[key]["lower limit"], told[key]["upper limit"]], [low, high])


def test_a_limit_in_front_of_the_noise_is_found(bench):
    """Readings that pile up within their noise of the limit are flagged, most of them."""
    made = bench()
    rows = made.rows_T.copy()
    value = float(np.quantile(rows[:, 7], 0.97))
    beyond = rows[:, 7] > value
    rows[beyond, 7] = value + np.random.default_rng(4).normal(0, 1e-9, beyond.sum())
    found = SATURATION.find(made.with_rows(rows).residuals())
    assert [(part.sensor, part.axis) for part in found.fitted.contributions] == [(2, 1)]
    assert_allclose(found.fitted.contributions[0].values["upper limit"], value, rtol=0, atol=1e-9)
    assert found.flagged[beyond].mean() > 0.9 and found.flagged[~beyond].mean() < 0.01


def cut_short(made, *others):
    """Return readings of which the largest of an axis is hardly larger than the next, and others are struck."""
    rows = made.rows_T.copy()
    order = np.argsort(rows[:, 7])
    rows[order[-1], 7] = rows[order[-2], 7] + 1e-9
    rows[list(others), 7] -= 30e-9
    return made.with_rows(rows).residuals(), int(order[-1])


def test_coarse_steps_are_no_limit(bench):
    """Readings that repeat at their largest because they are rounded are not cut off."""
    made = bench(moves=True)
    rows = made.rows_T.copy()
    rows[:, :12] = np.round(rows[:, :12] / 200e-9) * 200e-9
    assert isinstance(SATURATION.find(made.with_rows(rows).residuals()), str)


def test_a_bent_transfer_function_is_no_limit(bench):
    """A sensor that loses sensitivity smoothly has no limit."""
    made = bench()
    rows = made.rows_T.copy()
    part = rows[:, 7] / 50e-6
    rows[:, 7] -= 60e-9 * part**3
    assert isinstance(SATURATION.find(made.with_rows(rows).residuals()), str)


def test_found_again_when_left_out(bench):
    """Once its samples do not count they are found as before, with the same gain."""
    cut = bench().with_effect(SATURATION, limit(1, 0, upper=44e-6))
    first = SATURATION.find(cut.residuals())
    again = SATURATION.find(cut.residuals(is_counted=~first.flagged))
    assert_array_equal(again.flagged, first.flagged)
    assert_allclose(again.gain, first.gain)


def test_all_sensors_may_have_one_range(bench):
    """Added to all sensors, every axis is cut off and the scalar is not."""
    made = bench()
    rows = made.with_effect(SATURATION, limit(ALL, None, upper=30e-6, lower=-30e-6)).rows_T
    assert_allclose(np.abs(rows[:, :12]).max(axis=0), 30e-6)
    assert_array_equal(rows[:, 12], made.rows_T[:, 12])


def short_by(made, errors, *others):
    """Return readings of an axis of which the largest falls short by so many standard errors, and others by theirs."""
    row, rows, residuals = 7, made.rows_T.copy(), made.residuals()
    deviation = np.sqrt(residuals.row_information[:, row])
    for sample, size in ((int(np.argmax(rows[:, row])), errors), *others):
        rows[sample, row] -= residuals.row_shift_T[sample, row] + size / deviation[sample]
    return made.with_rows(rows).residuals()


@pytest.mark.parametrize(("beyond", "is_limit"), [(3, False), (6, True)])
def test_four_readings_within_their_noise_are_a_limit(bench, beyond, is_limit):
    """Fewer may be spikes."""
    made = bench(1000, moves=False)
    rows = made.rows_T.copy()
    order = np.argsort(rows[:, 7])
    rows[order[-beyond:], 7] = rows[order[-beyond - 1], 7] + np.random.default_rng(4).normal(2e-9, 0.5e-9, beyond)
    assert bool(find_limits(made.with_rows(rows).residuals())) == is_limit
