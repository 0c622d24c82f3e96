"""Readings that repeat the one before, or come late."""

import numpy as np
import pytest
from findings import evidence
from numpy.testing import assert_allclose

from tam_calibration.effects.single_samples import Explained, Outliers, StaleSamples, of_their_own
from tam_calibration.model.fitted_effect import Contribution

STALE = StaleSamples()
OWN = slice(6, 9)
"""Rows of the third sensor."""


def repeated(made, stale, fresh_T=0.0):
    """Return the rows where samples of the third sensor hold the reading before, with noise of its own on it."""
    rows = made.rows_T.copy()
    for sample in np.flatnonzero(stale):
        rows[sample, OWN] = rows[sample - 1, OWN]
    rows[stale, OWN] += np.random.default_rng(7).normal(0, 1.0, (stale.sum(), 3)) * fresh_T
    return rows


def late(made, by, start=500, length=40):
    """Return the rows where a window of the third sensor is that of some samples before."""
    rows = made.rows_T.copy()
    rows[start : start + length, OWN] = made.rows_T[start - by : start + length - by, OWN]
    return rows


@pytest.mark.parametrize("fresh_T", [0.0, 1e-9])
@pytest.mark.parametrize("rate", [0.001, 0.02, 0.3, 0.45])
@pytest.mark.parametrize("sensors", [3, 4])
def test_repeats_are_found(bench, rate, fresh_T, sensors):
    """All repeats are flagged, and nothing else, whether noise comes behind them or not, at one sensor of a few."""
    made = bench(sensors=sensors)
    stale = np.random.default_rng(5).random(2000) < rate
    stale[0] = False
    residuals = made.with_rows(repeated(made, stale, fresh_T)).residuals()
    found = STALE.find(residuals)
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis, part.term) == (2, None, "repeats")
    assert_allclose(part.values["rate"], stale.mean(), atol=0.002)
    assert found.flagged[stale].mean() > 0.98 and not found.flagged[~stale].any()
    assert evidence(found, residuals) > 100


def test_a_sensor_is_no_cause_for_what_another_repeats():
    """Few samples, in all of which another sensor with many is displaced too, are those of that sensor."""
    samples = np.arange(100)
    few, many, apart = (Explained(samples % step == rest, None, None) for step, rest in ((50, 0), (2, 0), (50, 1)))
    assert of_their_own([few, many, apart]) == [many, apart]


def test_a_single_repeat_is_told_from_a_spike(bench):
    """It explains what a spike does with fewer numbers; a spike of the same size in another direction is none."""
    made, stale = bench(), np.arange(2000) == 777
    residuals = made.with_rows(repeated(made, stale)).residuals()
    found = STALE.find(residuals)
    assert found.flagged.nonzero()[0].tolist() == [777]
    assert evidence(found, residuals) > evidence(Outliers().find(residuals), residuals)
    rows = made.rows_T.copy()
    rows[777, OWN] += np.roll(made.rows_T[776, OWN] - made.rows_T[777, OWN], 1)
    assert isinstance(STALE.find(made.with_rows(rows).residuals()), str)


@pytest.mark.parametrize("by", [1, 3, 8])
def test_late_packets_are_found(bench, by):
    """The window is flagged, and by how many samples it is late is told."""
    made = bench()
    found = STALE.find(made.with_rows(late(made, by)).residuals())
    (part,) = found.fitted.contributions
    assert (part.sensor, part.term) == (2, "late packets")
    assert part.values["samples late"] == by and part.values["burst"] == 40
    assert found.flagged.nonzero()[0].tolist() == list(range(500, 540))


def test_what_is_later_than_eight_samples_is_something_else(bench):
    """No queue holds so many."""
    made = bench()
    assert isinstance(STALE.find(made.with_rows(late(made, 14)).residuals()), str)


def test_a_value_held_for_long_is_a_repeat(bench):
    """Five samples in a row have the value of the one before them."""
    made, stale = bench(), np.isin(np.arange(2000) % 200, range(50, 55))
    (part,) = STALE.find(made.with_rows(repeated(made, stale)).residuals()).fitted.contributions
    assert part.term == "repeats" and part.values["burst"] == 5


def test_a_sensor_that_is_always_late_is_not_stale(bench):
    """What most samples are is a constant delay."""
    made = bench()
    for length in (1400, 1900):
        assert isinstance(STALE.find(made.with_rows(late(made, 1, 50, length)).residuals()), str)


def test_a_tilted_calibration_is_no_obstacle(bench):
    """Errors by which the sensor is off by fifty times its noise leave the samples the same."""
    made, stale = bench(), np.random.default_rng(5).random(2000) < 0.2
    stale[0] = False
    rows = repeated(made, stale)
    rows[:, OWN] += rows[:, OWN] @ (1e-3 * np.arange(9).reshape(3, 3)) + 60e-9
    found = STALE.find(made.with_rows(rows).residuals())
    assert found.flagged[stale].mean() > 0.98 and not found.flagged[~stale].any()


def test_several_sensors_are_told(bench):
    """Two that repeat at different times are both named."""
    made, stale = bench(), np.arange(2000) % 97 == 30
    rows = repeated(made, stale)
    others = np.flatnonzero(stale[:-20]) + 20
    rows[others, :3] = rows[others - 1, :3]
    assert [one.sensor for one in STALE.find(made.with_rows(rows).residuals()).fitted.contributions] == [0, 2]


def test_one_sensor_alone_is_told(bench):
    """It has no other that tells where the field was."""
    assert "one sensor alone" in STALE.obstacle(bench(200, 1).covariates)


@pytest.mark.parametrize(("term", "samples"), [("repeats", 1.0), ("late packets", 3.0)])
def test_the_twin_shows_what_was_found(bench, term, samples):
    """Rate, length and delay of simulated samples are found again."""
    values = {"rate": 0.05, "burst": 10.0 if samples > 1 else 1.0, "samples late": samples}
    made = bench(8000).with_effect(STALE, Contribution(1, None, term, values))
    (part,) = STALE.find(made.residuals()).fitted.contributions
    assert (part.sensor, part.term) == (1, term) and part.values["samples late"] == samples
    assert_allclose([part.values["rate"], part.values["burst"]], [0.05, values["burst"]], rtol=0.35)


def test_a_sensor_that_stands_still_repeats_its_last_reading(bench):
    """Readings that are held for longer than a queue is long are repeats in all these samples."""
    made = bench(sensors=4)
    held = np.zeros(2000, dtype=bool)
    for start, length in ((100, 30), (900, 60), (1500, 25)):
        held[start : start + length] = True
    found = STALE.find(made.with_rows(repeated(made, held)).residuals())
    (part,) = found.fitted.contributions
    assert (part.sensor, part.term) == (2, "repeats")
    assert found.flagged[held].mean() > 0.95 and not found.flagged[~held].any()
