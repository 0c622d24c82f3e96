"""The fit of one sensor in the field of the world bears jumps of any size, and gives way where lengths tell more."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.model import Model
from tam_calibration.gap.size import measure

MAGNET_T = np.array([-3e-6, -0.3e-6, 27e-6])


def magnet(made, start, stop, size=1.0):
    """Return a run with a magnet at the sensor between two samples."""
    added = np.zeros((made.recording.sample_count, 3))
    added[start:stop] = size * MAGNET_T
    return made.with_added(added)


@pytest.mark.parametrize("stop", [600, 900])
def test_a_magnet_is_found_to_the_sample(lone, stop):
    """For good, or on and off, whatever the mount of the attitude: times, offsets and calibration are the truth."""
    made = lone()
    judged = judge(magnet(made, 300, stop).recording, made.array)
    step = np.diff(made.recording.time_s)[0]
    times = [made.recording.time_s[cut] - step / 2 for cut in (300, stop) if cut < 900]
    (cause,) = judged.gap.causes
    assert cause.fitted.effect == "bias_jump"
    assert_allclose(list(cause.fitted.shape.values()), times, atol=1e-9)
    assert_allclose([one.values["offset"] for one in cause.fitted.contributions], MAGNET_T, atol=2e-9)
    model = judged.found.model
    assert_allclose(model.errors.matrix, made.errors.matrix, atol=1e-4)
    assert_allclose(model.errors.bias_T, made.errors.bias_T, atol=2e-9)
    assert_allclose(model.world.field_T, made.world.field_T, atol=5e-9)
    assert_allclose(model.world.mount, made.world.mount, atol=1e-4)


def test_noise_alone_is_fitted_to_the_noise(lone):
    """The fit is as good as the noise."""
    made = lone()
    model = Model.nominal(made.recording, made.array)
    assert model.base().channels.energy == pytest.approx(2700, rel=0.1)


def test_a_poor_attitude_gives_way_to_the_length_of_the_field(lone):
    """With an attitude known to 0.5° only, a sensor of 1 nT is judged by lengths, which do not know of attitudes."""
    made = lone(attitude_noise=np.radians(0.5))
    assert Model.nominal(made.recording, made.array).world is None


def test_a_tone_across_the_field_leaves_the_sensor_in_the_world(lone):
    """Where it is turned little the length hides half of the tone, and is not taken for the surer by that."""
    made = lone(3000)
    along = np.abs(made.field_T[:, 2]) > 0.7 * made.world.intensity_T
    tone = np.outer(20e-6 * np.sin(9.7 * made.recording.time_s), [1, 0, 0])
    assert Model.nominal(made.with_added(tone).recording.take(along), made.array).world is not None


def test_with_a_scalar_lengths_stay_what_they_were(lone):
    """A measured intensity is worth more than an attitude."""
    made = lone()
    recording = replace(made.recording, scalar_T=np.linalg.norm(made.field_T, axis=1))
    assert Model.nominal(recording, replace(made.array, scalar_noise_T=1e-9)).world is None


def test_samples_without_attitude_do_not_count(lone):
    """A time without attitude, in which the sensor is turned on, is left out of the fit and of its energy."""
    made = lone()
    attitude = made.recording.attitude.copy()
    attitude[400:470] = np.nan
    model = Model.nominal(replace(made.recording, attitude=attitude), made.array)
    assert model.world is not None
    assert not model.is_counted[400:470].any()
    assert model.is_counted.sum() == 830
    assert model.base().channels.energy == pytest.approx(3 * 830, rel=0.1)


def test_a_wild_reading_does_not_hide_the_times_without_attitude(lone):
    """The model of all samples knows which have no attitude, those far off left out of the fit only."""
    made = lone()
    attitude = made.recording.attitude.copy()
    attitude[400:470] = np.nan
    readings = made.recording.readings_T.copy()
    readings[5] *= 50
    model = Model.nominal(replace(made.recording, attitude=attitude, readings_T=readings), made.array)
    assert model.is_counted.sum() == 830


def test_a_turn_about_one_axis_is_fitted_as_far_as_it_tells(lone):
    """What such a turn leaves open stays where it is; what is read is fitted to the noise."""
    made = lone()
    attitude = Rotation.from_rotvec(np.outer(made.recording.time_s, [0, 0, 0.7]))
    readings = made.errors.distort(attitude.inv().apply(made.world.field_T))
    noise = 1e-9 * np.random.default_rng(3).normal(size=readings.shape)
    recording = replace(made.recording, readings_T=readings + noise, attitude=attitude.as_quat())
    model = Model.nominal(recording, made.array)
    assert model.world is not None
    assert model.base().channels.energy == pytest.approx(2700, rel=0.1)


@pytest.mark.parametrize("noise_T", [20e-9, 60e-9])
def test_the_noise_of_the_attitude_is_told_from_that_of_the_sensor(lone, noise_T):
    """An attitude known to 0.03° adds its share to the variance of each row, which then leaves no excess."""
    made = lone(3000, noise_T, np.radians(0.03))
    model = Model.nominal(made.recording, made.array)
    unit = made.field_T / made.world.intensity_T
    expected = (np.radians(0.03) * made.world.intensity_T) ** 2 * (1 - np.mean(unit**2, axis=0))
    assert_allclose(model.world.variance_T2, expected, atol=0.06 * (expected.mean() + noise_T**2))
    assert model.base().channels.energy == pytest.approx(9000, rel=0.06)


def test_a_noisy_sensor_does_not_make_the_attitude_noisy(lone):
    """Noise of twice the sheet is the sensor's, along the field as across it."""
    made = lone(3000, 20e-9)
    sheet = replace(made.array, vector_noise_T=np.array([10e-9]))
    model = Model.nominal(made.recording, sheet)
    assert np.all(model.world.variance_T2 < 0.1 * 20e-9**2)
    assert model.base().channels.energy == pytest.approx(4 * 9000, rel=0.1)


def test_the_size_of_a_gap_does_not_depend_on_the_noise_of_the_attitude(lone):
    """A tone of 200 nT in one axis is told as that, in nT of one axis of three, whatever its noise floors."""
    made = lone(3000, 20e-9, np.radians(0.03))
    tone = np.outer(200e-9 * np.sqrt(2) * np.sin(1.7 * made.recording.time_s), [1, 0, 0])
    model = Model.nominal(made.with_added(tone).recording, made.array)
    assert model.world.variance_T2.any()
    assert measure(model, model, 1.0).before_T == pytest.approx(200e-9 / np.sqrt(3), rel=0.1)
