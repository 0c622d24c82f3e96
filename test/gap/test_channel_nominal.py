"""A bias that follows a recorded channel, however large, does not move the calibration that a diagnosis starts from."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.model import Model
from tam_calibration.gap.nominal import without_channels

SLOPES_T = 12e-6 * np.random.default_rng(5).normal(size=(2, 12))
"""What the rows of four sensors do with an ampere, and with a kelvin."""


def following(made, of_current=1.0, of_temperature=1.0):
    """Return the run with biases that follow its channels, and what they add (N, K, 3) about the channels' medians."""
    recording = made.recording
    courses = [channel - np.median(channel) for channel in (recording.current_A, recording.temperature_C)]
    rows = SLOPES_T[:, : made.row_count - 1] * np.array([[of_current], [of_temperature]])
    added = np.column_stack([np.transpose(courses) @ rows, np.zeros(recording.sample_count)])
    return made.with_added(added), added[:, :-1].reshape(recording.readings_T.shape)


@pytest.mark.parametrize("has_scalar", [True, False])
@pytest.mark.parametrize(("of_current", "of_temperature"), [(1, 0.5), (2, 0), (0, 1)])
def test_what_follows_the_channels_is_taken_off(run, has_scalar, of_current, of_temperature):
    """Tens of microtesla, of one channel or of both, to some nanotesla: what is left is the run without."""
    made = run(900, 4, has_scalar=has_scalar)
    disturbed, added = following(made, of_current, of_temperature)
    assert np.abs(added).max() > 20e-6
    assert_allclose(without_channels(disturbed.recording).readings_T, made.recording.readings_T, atol=20e-9)


def test_the_attitude_tells_it_of_one_sensor(lone):
    """In the field of the world, from the samples whose attitude is known, in all of them."""
    made = lone()
    time = made.recording.time_s
    recording = replace(made.recording, current_A=2.0 * (np.sin(0.83 * time) > 0.2))
    added = np.outer(recording.current_A - np.median(recording.current_A), SLOPES_T[0, :3])
    attitude = recording.attitude.copy()
    attitude[400:470] = attitude[0]
    is_oriented = (np.arange(900) < 400) | (np.arange(900) >= 470)
    disturbed = replace(recording, readings_T=recording.readings_T + added[:, None], attitude=attitude)
    rest = without_channels(disturbed, is_oriented)
    assert_allclose(rest.readings_T, recording.readings_T, atol=2e-9)


@pytest.mark.parametrize(("size", "is_much"), [(1.9, True), (1.5, False)])
def test_only_what_is_most_of_the_rest_is_taken_off(lone, size, is_much):
    """What has three times the squares of the noise makes them fall to a quarter by what is told of it."""
    made = lone(noise_T=1e-6)
    current = np.sin(0.83 * made.recording.time_s)
    added = size * 1e-6 * np.outer(current / current.std(), [1, -1, 1])
    recording = replace(made.recording, readings_T=made.recording.readings_T + added[:, None], current_A=current)
    rest = without_channels(recording, np.ones(900, dtype=bool))
    assert (rest is not None) == is_much


def test_nothing_is_taken_off_that_no_channel_tells(run, lone):
    """Noise alone, no channels, channels that do not change, readings of no ellipsoid, and a bias of another course."""
    made = run(900, 2)
    recording = made.recording
    assert without_channels(recording) is None
    disturbed = following(made)[0].recording
    assert without_channels(replace(disturbed, current_A=None, temperature_C=None)) is None
    still = replace(disturbed, current_A=np.ones(900), temperature_C=np.full(900, 20.0))
    assert without_channels(still) is None
    noise = 1e-6 * np.random.default_rng(1).normal(size=recording.readings_T.shape) ** 3
    assert without_channels(replace(recording, readings_T=noise)) is None
    alone = lone().recording
    assert without_channels(replace(alone, temperature_C=20 + alone.time_s), np.ones(900, dtype=bool)) is None


def test_the_nominal_fit_of_an_array_begins_at_the_truth(run):
    """At the middle of the channels, where the bias is what it adds there more than without."""
    made = run(900, 2, has_scalar=False)
    disturbed, _ = following(made)
    model = Model.nominal(disturbed.recording, made.array)
    assert_allclose(model.errors.bias_T, made.errors.bias_T, atol=20e-9)
    assert_allclose(model.errors.matrix, made.errors.matrix, atol=1e-3)
    assert model.recording.readings_T is disturbed.recording.readings_T


def test_the_nominal_fit_of_one_sensor_stays_in_the_world(lone):
    """A current that comes and goes across the field leaves its length alone, which then is not taken for the surer."""
    made = lone()
    current = 2.0 * (np.sin(0.83 * made.recording.time_s) > 0.2)
    added = np.outer(current - np.median(current), [8e-6, -6e-6, 1e-6])
    recording = replace(made.recording, readings_T=made.recording.readings_T + added[:, None], current_A=current)
    model = Model.nominal(recording, made.array)
    assert model.world is not None
    assert_allclose(model.errors.bias_T, made.errors.bias_T, atol=5e-9)


def test_a_jump_beside_a_channel_that_rises_with_it_is_a_jump(run):
    """A temperature that rises about the same time explains most of a magnet that stays, and the jump all of it."""
    made = run(900, 2, has_scalar=False)
    added = np.zeros((900, made.row_count))
    added[450:, :3] = [20e-6, -15e-6, 10e-6]
    temperature = 25 + 5 * np.tanh((made.recording.time_s - 30) / 13)
    recording = replace(made.with_added(added).recording, current_A=None, temperature_C=temperature)
    assert without_channels(recording) is not None
    judged = judge(recording, made.array)
    assert judged.gap.named == ("bias_jump",)
    assert_allclose(judged.found.model.errors.bias_T, made.errors.bias_T, atol=0.1e-6)
