"""The floor of each row is that of its noise, whatever is slow, a tone, a spike or a step in the residual."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import freqz, lfilter

from tam_calibration.effects.grades import LEAST_SAMPLES
from tam_calibration.gap.floor import Floor, _median_turn, _middle, floor_of, white_variance
from tam_calibration.model.array import Array


def floor(made, stated=None):
    """Return the floor of a run at its true errors."""
    return floor_of(made.channels(), made.array if stated is None else stated)


def added(made, seed, size_T, colour=0.0, rows=None):
    """Return a run with noise of so much in some rows, correlated from sample to sample."""
    samples, count = made.recording.sample_count, made.row_count
    white = np.random.default_rng(seed).normal(size=(samples, count))
    noise = size_T * lfilter([np.sqrt(1 - colour**2)], [1, -colour], white, axis=0)
    noise[:, -1] = 0
    if rows is not None:
        noise[:, [row for row in range(count) if row not in rows]] = 0
    return made.with_added(noise)


@pytest.mark.parametrize("sensors", [1, 2, 4])
def test_the_floor_is_the_noise(run, sensors):
    """Of every row within what 3000 samples tell, and white; without a remark where the sheet has it."""
    made = run(3000, sensors, has_scalar=False)
    found = floor(made)
    assert_allclose(found.level_T[:-1], 1e-9, rtol=0.15)
    assert_allclose(found.colour[:-1], 0, atol=0.08)
    assert found.factor_common_to_all(3000) == 1


def test_the_noisier_axis_is_told(run):
    """One of twelve rows has ten times the noise; the others keep theirs, and so does what is common to all."""
    found = floor(added(run(3000), 5, 10e-9, rows=[4]))
    assert found.level_T[4] == pytest.approx(10e-9, rel=0.15)
    assert_allclose(np.delete(found.level_T[:-1], 4), 1e-9, rtol=0.3)
    assert found.factor_common_to_all(3000) == 1


@pytest.mark.parametrize("kind", ["drift", "tone", "spikes", "jump", "rounding"])
def test_the_floor_holds_beside_what_is_no_noise(run, kind):
    """Each thirty floors large in all rows, rounding in steps of ten."""
    made = run(3000)
    time, generator = made.recording.time_s, np.random.default_rng(2)
    signal = {
        "drift": 30e-9 * np.cos(0.4 * time),
        "tone": 30e-9 * np.sin(2 * np.pi * 0.31 * np.arange(3000)),
        "spikes": 1e-6 * (generator.random(3000) < 0.01),
        "jump": 30e-9 * (time > 31),
        "rounding": np.zeros(3000),
    }[kind]
    weight = generator.normal(size=made.row_count) * (np.arange(made.row_count) < 12)
    made = made.with_added(signal[:, None] * weight)
    if kind == "rounding":
        readings = np.round(made.recording.readings_T / 10e-9) * 10e-9
        made = replace(made, recording=replace(made.recording, readings_T=readings))
    found = floor(made)
    assert np.median(found.level_T[:-1]) < 1.5e-9 and found.factor_common_to_all(3000) == 1


def test_coloured_noise_is_told_with_its_colour(run):
    """Ten floors of noise with the correlation 0.8: its total is that, and its white part less."""
    found = floor(added(run(6000), 3, 10e-9, colour=0.8))
    assert_allclose(found.colour[:-1], 0.76, atol=0.06)
    assert_allclose(found.total_T[:-1], 10e-9, rtol=0.25)
    assert (found.level_T[:-1] < 0.5 * found.total_T[:-1]).all()


@pytest.mark.parametrize(
    ("factor", "common"), [(0.1, 10.0), (0.43, 2.33), (0.57, 1), (1.75, 1), (2.3, 0.43), (10.0, 0.1)]
)
def test_a_sheet_that_is_far_off_is_contradicted(run, factor, common):
    """Up to twice or half of the noise it may be right."""
    made = run(3000)
    stated = Array(made.array.positions_m, factor * made.array.vector_noise_T, made.array.scalar_noise_T)
    assert floor(made, stated).factor_common_to_all(3000) == pytest.approx(common, rel=0.1)


def test_few_samples_contradict_a_sheet_by_more_than_chance_only(run):
    """With 64 samples a factor of e is five deviations: 2.4 times the noise is not told, 3.5 times is."""
    for factor, told in ((2.4, False), (3.5, True)):
        stated = Array(np.zeros((4, 3)), np.full(4, 1e-9 / factor), 2e-10)
        made = (run(3000, seed=seed) for seed in range(9))
        short = (replace(one, recording=one.recording.take(slice(64))) for one in made)
        common = [floor(one, stated).factor_common_to_all(64) > 1 for one in short]
        assert (sum(common) > 4) == told


def test_attitudes_that_leap_tell_no_floor(run):
    """Of 1200 samples of a tumble in an order by chance the differences hold the motion."""
    made = run(1200)
    order = np.random.default_rng(0).permutation(1200)
    recording = replace(
        made.recording,
        readings_T=made.recording.readings_T[order],
        scalar_T=made.recording.scalar_T[order],
    )
    assert not floor(replace(made, recording=recording), Array(made.array.positions_m)).is_determined


def test_samples_that_fill_lines_are_left_out(run):
    """Every second sample is the mean of its neighbours: the floor is that of the others."""
    made = run(3000, 1, has_scalar=False)
    readings = made.recording.readings_T.copy()
    readings[1:-1:2] = (readings[:-2:2] + readings[2::2]) / 2
    found = floor(replace(made, recording=replace(made.recording, readings_T=readings)))
    assert_allclose(found.level_T[:-1], 1e-9, rtol=0.25)


@pytest.mark.parametrize(("part", "is_seen"), [(0.2, False), (0.45, True)])
def test_rounding_hides_noise_that_is_far_smaller(run, part, is_seen):
    """Noise of a fifth of the variance of rounding is taken from the sheet, of not quite half of it from the data."""
    noise_T = 10e-9 * np.sqrt(part / 12)
    made = run(6000, 4, has_scalar=False, noise_T=noise_T)
    readings = np.round(made.recording.readings_T / 10e-9) * 10e-9
    made = replace(made, recording=replace(made.recording, readings_T=readings))
    found = floor(made, Array(made.array.positions_m, 4 * made.array.vector_noise_T))
    assert np.median(found.level_T[:-1]) / noise_T == pytest.approx(1 if is_seen else 4, rel=0.1)


@pytest.mark.parametrize(("samples", "is_determined"), [(820, True), (440, False)])
def test_turns_of_less_than_six_degrees_tell_the_floor(run, samples, is_determined):
    """From sample to sample the field turns by 0.073 rad, or by 0.135: then differences hold the motion."""
    assert floor(run(samples, 1, has_scalar=False)).is_determined == is_determined


@pytest.mark.parametrize(("samples", "is_determined"), [(15, False), (28, True)])
def test_a_dozen_samples_tell_no_floor(run, samples, is_determined):
    """Neither of the sensors nor of the scalar; some thirty do."""
    made = run(3000)
    found = floor(replace(made, recording=made.recording.take(slice(samples))))
    assert found.is_determined == is_determined == np.isfinite(found.level_T[-1])


def test_an_array_at_rest_does_not_turn():
    """Also where rounding makes the length of its direction more than one, whose angle no cosine has."""
    directions = np.random.default_rng(3).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert (np.sum(directions**2, axis=1) > 1).any()
    turns = [_median_turn(SimpleNamespace(direction=np.tile(one, (5, 1)))) for one in directions]
    assert np.max(turns) < 1e-7


@pytest.mark.parametrize("colour", [0.0, 0.3, 0.84, 0.99])
def test_the_total_has_the_floor_at_three_quarters_of_the_band(colour):
    """As scipy tells the power of an AR(1) process there, over that of white noise of its variance."""
    response = freqz([np.sqrt(1 - colour**2)], [1, -colour], worN=[0.75 * np.pi])[1][0]
    found = Floor(np.full(4, 2e-9), np.full(4, colour), np.full(4, np.nan))
    assert_allclose(found.total_T, 2e-9 / np.abs(response), rtol=1e-9)


def test_a_floor_is_determined_where_that_of_each_axis_is():
    """Whatever the scalar magnetometer has."""
    for row, is_determined in ((0, False), (11, False), (12, True)):
        level = np.where(np.arange(13) == row, np.nan, 1e-9)
        assert Floor(level, np.zeros(13), np.zeros(13)).is_determined == is_determined


def test_what_most_rows_have_is_the_lower_median():
    """Of an odd number the one in the middle, of an even number the smaller of the two."""
    assert (_middle(np.array([9.0, 1.0, 2.0])), _middle(np.array([4.0, 1.0, 3.0, 2.0]))) == (2.0, 2.0)


def test_the_white_variance_between_the_sensors_is_that_of_the_noise_alone(run):
    """It is 1 where the array has it, beside a drift of twenty times the noise too; 0 without channels or samples."""
    made = run(3000)
    drifting = made.with_row(4, 20e-9 * np.sin(np.linspace(0, 9, 3000)))
    for one in (made, drifting):
        variance, error = white_variance(one.channels().differential)
        assert abs(variance - 1) < 4 * error and error < 0.03
    assert white_variance(np.zeros((300, 0))) == white_variance(np.ones((LEAST_SAMPLES - 1, 3))) == (0, 0)


@pytest.mark.parametrize(("count", "width"), [(400, 1), (1600, 1), (400, 9)])
def test_the_standard_error_of_the_white_variance_is_its_scatter(count, width):
    """Of three hundred draws of white noise."""
    noise = np.random.default_rng(5).normal(size=(300, count, width))
    found = np.array([white_variance(one) for one in noise])
    assert np.std(found[:, 0]) == pytest.approx(np.mean(found[:, 1]), rel=0.2)
