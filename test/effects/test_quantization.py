"""Readings that are whole steps, where rounding is a visible part of the noise."""

import numpy as np
import pytest
from findings import evidence
from numpy.testing import assert_allclose

from tam_calibration.effects.converter import Lattice, Quantization, _by_step, _frequency, _visible, find_lattices
from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution

QUANTIZATION = Quantization()


def steps(sensor, axis, step, offset=0.0):
    """Return what the effect does at one place."""
    return Contribution(sensor, axis, "lattice", {"step": step, "offset": offset})


@pytest.mark.parametrize("decimals", [1, 2, 3])
def test_decimals_of_a_file_do_not_matter(bench, decimals):
    """Readings of 1 nT of noise that are written with decimals are no finding, and hide no coarser steps."""
    made = bench()
    written = made.with_rows(np.round(made.rows_T * 1e9, decimals) / 1e9)
    assert isinstance(QUANTIZATION.find(written.residuals()), str)
    coarse = made.with_effect(QUANTIZATION, steps(1, 2, 3.7391e-9, 0.4e-9)).rows_T
    found = QUANTIZATION.find(made.with_rows(np.round(coarse * 1e9, decimals) / 1e9).residuals())
    assert_allclose(found.fitted.contributions[0].values["step"], 3.7391e-9, rtol=1e-4)


@pytest.mark.parametrize("size", [1.5, 4.0, 40.0])
@pytest.mark.parametrize(("samples", "moves"), [(60, False), (400, True), (4000, True)])
def test_the_steps_of_an_axis_are_found(bench, size, samples, moves):
    """Step and offset come out exactly, on a floor that is not the data sheet's."""
    made = bench(samples, moves=moves, sheet=1.05).with_effect(QUANTIZATION, steps(2, 0, size * 1e-9, 0.3e-9))
    (lattice,) = find_lattices(made.residuals())
    assert lattice.row == 6
    assert_allclose(lattice.step_T, size * 1e-9, rtol=1e-9)
    offset = (lattice.offset_T - 0.3e-9) / lattice.step_T
    assert abs(offset - round(offset)) < 1e-4


@pytest.mark.parametrize(("sensor", "axis"), [(2, 0), (SCALAR, None)])
def test_the_gain_is_that_of_the_energy_of_rounding(bench, sensor, axis):
    """Rounding explains its own energy, more than a noise of free variance does, and adds step²/12 to the variance."""
    made = bench().with_effect(QUANTIZATION, steps(sensor, axis, 4e-9 if sensor != SCALAR else 1.1e-9))
    residuals = made.residuals()
    found = QUANTIZATION.find(residuals)
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis) == (sensor, axis)
    row = 12 if sensor == SCALAR else 6
    assert_allclose(found.variance[row], part.values["step"] ** 2 / 12)
    energy, count = residuals.energy.sum(), residuals.channel_count.sum()
    rounding = (residuals.row_information @ found.variance).sum()
    assert_allclose(found.gain, count * np.log(energy / (energy - rounding)))
    # A scalar magnetometer in a steady field meets two steps only: its rounding errors are not uniform.
    assert_allclose(energy - rounding, count, rtol=0.02 if sensor != SCALAR else 0.1)
    noise = NoiseExcess().find(residuals)
    assert evidence(found, residuals) > evidence(noise, residuals) > 50


def test_the_steps_of_a_sensor_and_of_all(bench):
    """A sensor is told by its axes, all sensors with one step at once; both at once too."""
    made = bench()
    sensor = QUANTIZATION.find(made.with_effect(QUANTIZATION, steps(3, None, 3e-9)).residuals())
    assert [(part.sensor, part.axis) for part in sensor.fitted.contributions] == [(3, 0), (3, 1), (3, 2)]
    whole = made.with_effect(QUANTIZATION, steps(ALL, None, 5e-9))
    found = QUANTIZATION.find(whole.residuals())
    (part,) = found.fitted.contributions
    assert (part.sensor, part.axis) == (ALL, None)
    assert_allclose(part.values["step"], 5e-9, rtol=1e-9)
    assert evidence(found, whole.residuals()) > 100


def test_stated_noise_may_hold_the_rounding(bench):
    """Where the residual is no larger than the data sheet says, rounding makes no gap."""
    made = bench(noise_T=0.3e-9, sheet=0.2).with_effect(QUANTIZATION, steps(ALL, None, 2.0e-9))
    assert "already holds its rounding" in QUANTIZATION.find(made.residuals())


def test_a_small_part_of_the_gap_is_none(bench):
    """Beside a gap that is a hundred times larger, steps of one noise are not named."""
    made = bench().with_effect(QUANTIZATION, steps(ALL, None, 1.0e-9))
    rows = made.rows_T.copy()
    rows[1000:, 4] += 60e-9
    rows[:, 4] = np.round(rows[:, 4] / 1e-9) * 1e-9
    assert "a small part" in QUANTIZATION.find(made.with_rows(rows).residuals())


def test_a_limit_is_no_lattice(bench):
    """Readings of which many repeat, as in rest, are on no lattice unless all are."""
    made = bench(60, moves=False)
    rows = np.repeat(made.rows_T, 10, axis=0)
    rows = rows + np.random.default_rng(2).normal(0, 1e-9, rows.shape)
    again = bench(600, moves=False)
    assert find_lattices(again.with_rows(rows).residuals()) == []


@pytest.mark.parametrize(("step_T", "is_found"), [(0.35e-9, False), (0.7e-9, True)])
def test_steps_of_half_the_noise_are_sought(bench, step_T, is_found):
    """Rounding to finer ones adds nothing that matters."""
    made = bench(400).with_effect(QUANTIZATION, steps(2, 0, step_T))
    assert bool(find_lattices(made.residuals())) == is_found


def lattice_points(count, reach, step=0.7):
    """Return sorted readings on a lattice over some range, in standard deviations of the noise."""
    return np.sort(np.round(np.random.default_rng(1).uniform(0, reach, count) / step) * step)


@pytest.mark.parametrize(
    ("count", "reach", "is_found"), [(200, 350, False), (200, 700, True), (20, 5000, False), (36, 5000, True)]
)
def test_a_lattice_takes_readings_far_apart_and_many(count, reach, is_found):
    """Five hundred standard deviations apart, and two dozen differences of readings that are."""
    frequency = _frequency(lattice_points(count, reach))
    assert frequency == pytest.approx(1 / 0.7, rel=0.01) if is_found else frequency is None


@pytest.mark.parametrize(("off", "is_found"), [(0.07, True), (0.14, False)])
def test_readings_off_a_lattice_have_none(bench, off, is_found):
    """By less than a tenth of their noise they may be, by more they may not."""
    made = bench(600).with_effect(QUANTIZATION, steps(2, 0, 8e-9))
    rows = made.rows_T.copy()
    rows[:, 6] += off * 1e-9 * np.random.default_rng(2).normal(size=600)
    assert bool(find_lattices(made.with_rows(rows).residuals())) == is_found


@pytest.mark.parametrize(("part", "is_told"), [(0.07, False), (0.14, True)])
def test_rounding_must_make_a_tenth_of_the_gap(bench, part, is_told):
    """Beside a tone in another row that makes the rest of it."""
    made = bench().with_effect(QUANTIZATION, steps(2, 0, 6e-9))
    residuals = made.residuals()
    tone = np.sin(2 * np.pi * 0.31 * np.arange(2000))
    rounding = residuals.row_information[:, 6].sum() * 6e-9**2 / 12
    size = np.sqrt(rounding * (1 / part - 1) / (residuals.row_information[:, 4] @ tone**2))
    rows = made.rows_T.copy()
    rows[:, 4] += size * tone
    found = QUANTIZATION.find(made.with_rows(rows).residuals())
    assert ("a small part" in found) != is_told if isinstance(found, str) else is_told


def test_rounding_leaves_half_of_the_stated_noise(bench):
    """Where the sheet states three times too much, no more than down to that is explained."""
    residuals = bench(noise_T=0.3e-9, sheet=0.3).with_effect(QUANTIZATION, steps(ALL, None, 5e-9)).residuals()
    energy, count = residuals.energy.sum(), residuals.channel_count.sum()
    assert_allclose(QUANTIZATION.find(residuals).gain, count * np.log(2 * energy / count))


@pytest.mark.parametrize(
    ("rounding", "samples", "surplus", "is_shown"),
    [(1.0, 10**6, 0.37, False), (1.0, 10**6, 0.75, True), (0.1, 120, 0.4, False), (0.1, 400, 0.4, True)],
)
def test_the_residual_shows_rounding_beyond_chance(rounding, samples, surplus, is_shown):
    """Half of its variance, and three standard errors of the variance of so many samples."""
    kept = _visible([Lattice(0, np.sqrt(12 * rounding), 0.0)], np.array([1 + surplus, 1.0]), np.ones(2), samples)
    assert bool(kept) == is_shown


@pytest.mark.parametrize(("apart", "is_one"), [(0.007, True), (0.014, False)])
def test_steps_that_differ_by_a_hundredth_are_two(apart, is_one):
    """The same converter rounds all rows alike."""
    lattices = [Lattice(row, step, 0.0) for row, step in enumerate((1e-9, (1 + apart) * 1e-9))]
    assert (len(_by_step(lattices)) == 1) == is_one
