"""Lost readings that were filled on straight lines."""

import numpy as np
import pytest
from findings import evidence
from numpy.testing import assert_allclose

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.single_samples import InterpolatedSamples, StaleSamples, _digit, _lines
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import Contribution
from tam_calibration.model.sensor_errors import SensorErrors

FILLED = InterpolatedSamples()


def lines(made, starts, length):
    """Return the rows where windows of the second sensor lie on lines, and which samples do."""
    rows, filled = made.rows_T.copy(), np.zeros(len(made.rows_T), dtype=bool)
    for start in starts:
        part = (np.arange(1, length + 1) / (length + 1))[:, None]
        rows[start : start + length, 3:6] = (1 - part) * rows[start - 1, 3:6] + part * rows[start + length, 3:6]
        filled[start : start + length] = True
    return rows, filled


@pytest.mark.parametrize("length", [5, 12, 40])
def test_lines_are_found(bench, length):
    """The samples on them are flagged, and their part and length told."""
    made = bench()
    rows, filled = lines(made, (300, 700, 1500), length)
    residuals = made.with_rows(rows).residuals()
    found = FILLED.find(residuals)
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis, part.term) == (1, None, "lines")
    assert_allclose([part.values["rate"], part.values["burst"]], [filled.mean(), length], rtol=0.1)
    assert found.flagged[filled].mean() > 0.95 and found.flagged[~filled].mean() < 1e-3
    assert evidence(found, residuals) > 100 and isinstance(StaleSamples().find(residuals), str)


@pytest.mark.parametrize("digit_T", [0.0, 1e-12, 2e-11])
@pytest.mark.parametrize("length", [1, 3])
def test_what_is_straight_to_the_last_digit_is_a_line_however_short(bench, length, digit_T):
    """In all three axes at once noise never is, however many digits are written; all are found and nothing else."""
    made = bench()
    starts = np.arange(100, 1900, 60)
    rows, filled = lines(made, starts, length)
    rows = np.round(rows / digit_T) * digit_T if digit_T else rows
    found = FILLED.find(made.with_rows(rows).residuals())
    assert np.array_equal(found.flagged, filled)
    assert found.fitted.contributions[0].values["burst"] == length


def test_a_coarse_digit_makes_no_line(bench):
    """Rounded to as much as the noise, readings go straight at random."""
    made = bench()
    for digit_T in (5e-10, 2e-9, 2e-8):
        rows = made.rows_T.copy()
        rows[:, 3:6] = np.round(rows[:, 3:6] / digit_T) * digit_T
        assert isinstance(FILLED.find(made.with_rows(rows).residuals()), str)


def test_a_value_that_is_held_is_no_line_between_its_neighbours(bench):
    """It goes straight as well, but stale samples say more with as much."""
    made = bench()
    rows = made.rows_T.copy()
    for start in (400, 900):
        rows[start : start + 7, 3:6] = rows[start - 1, 3:6]
    residuals = made.with_rows(rows).residuals()
    found = FILLED.find(residuals)
    assert isinstance(found, str) or evidence(found, residuals) < evidence(StaleSamples().find(residuals), residuals)


def test_one_sensor_alone_is_told(bench):
    """It has no other that tells how the field went."""
    assert "one sensor alone" in FILLED.obstacle(bench(200, 1).covariates)


def test_the_twin_shows_what_was_found(bench):
    """Rate and length of simulated lines are found again, and nothing but that sensor is changed."""
    made = bench(8000)
    twin = made.with_effect(FILLED, Contribution(1, None, "lines", {"rate": 0.05, "burst": 20.0}))
    assert not (twin.rows_T - made.rows_T)[:, np.r_[0:3, 6:13]].any()
    (part,) = FILLED.find(twin.residuals()).fitted.contributions
    assert_allclose([part.values["rate"], part.values["burst"]], [0.05, 20], rtol=0.35)


@pytest.mark.parametrize(("straight", "is_found"), [(2, True), (4, False)])
def test_what_goes_straight_once_in_a_hundred_records_is_a_line(straight, is_found):
    """Of 400 samples two of the one axis go straight elsewhere: all axes do by chance in 0.0075 of the records.

    Where four do it is 0.0125.
    """
    index, generator = np.arange(400), np.random.default_rng(2)
    bend = np.where(index % 2 == 0, 1, -1)[:, None] * generator.integers(20, 60, (400, 2))
    bend[200] = 0
    bend[50 * np.arange(1, straight + 1) + 20, 1] = 0
    readings = np.column_stack([np.cumsum(np.cumsum(bend, axis=0), axis=0), 13 * index])
    readings[:, 2] -= 2 * np.maximum(index - 201, 0) + 3 * np.maximum(index - 390, 0)
    covariates = Covariates(0.1 * index, np.ones((400, 3)), SensorErrors.none(1), Array(np.zeros((1, 3))))
    rows = _lines(1e-9 * readings, covariates)
    assert [row.tolist() for row in rows] == ([[199]] if is_found else [])


@pytest.mark.parametrize(("step", "digit"), [(0.7e-13, 0.25), (1.4e-13, 1.4e-13)])
def test_what_the_computer_rounds_is_no_digit(step, digit):
    """Values closer than a ten-trillionth of the largest are one."""
    assert _digit(np.array([0.0, 0.25, 0.5, 1 - step, 1.0])) == pytest.approx(digit, rel=0.01)
