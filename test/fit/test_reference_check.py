"""A scalar that turns with the array keeps its mean; one in a field that drifts is believed."""

import re
from dataclasses import replace

import numpy as np
import pytest
from compasses import CROSS, ERRORS, circles, recorded, worst
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from swinging_circle import COUNT, RATE_HZ, WORLD_T, attitude_at, made

from tam_calibration.fit import calibrate
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.units import from_degrees


def read_beside(turns, seed, added_T):
    """Return a recording whose scalar reads a field (3,) or (N, 3) that is fixed to the array too."""
    recording = recorded(turns, seed)
    field_T = turns.inv().apply([0.0, 19e-6, -45e-6])
    size_T = np.linalg.norm(field_T + added_T, axis=1) - np.linalg.norm(field_T, axis=1)
    return replace(recording, scalar_T=recording.scalar_T + size_T)


@pytest.mark.parametrize("size_T", [3e-9, 150e-9])
def test_a_magnet_beside_the_scalar_costs_its_precision_only(size_T):
    """The answer says so, and its errors are within what it tells; without the test they were up to 1400 times that."""
    found = calibrate(read_beside(circles(), 1, size_T * np.array([0.6, -0.64, 0.48])), CROSS)
    assert any("the scalar follows the direction of the field" in note for note in (*found.warnings, *found.notes))
    assert found.has_scalar_reference and worst(found) < 4


def test_a_scalar_that_leaves_the_scale_open_is_not_used():
    """The calibration is that without a scalar. The size has no exponent, nor more digits than are known."""
    recording = read_beside(circles(), 1, 1.5e-6 * np.array([0.6, -0.64, 0.48]))
    found, without = calibrate(recording, CROSS), calibrate(replace(recording, scalar_T=None), CROSS)
    assert any(
        one.startswith("the scalar follows the direction of the field by 1500 nT, as near") for one in found.warnings
    )
    assert not found.has_scalar_reference
    assert_allclose(found.errors.to_vector(), without.errors.to_vector(), rtol=0, atol=1e-9)


def test_soft_iron_beside_the_scalar_has_the_size_of_its_amplitude():
    """It adds the same in opposite directions of the field, so that no magnet explains it."""
    turns = circles(80.0)
    direction = turns.inv().apply([0.0, 19.0, -45.0]) / 48.8
    recording = recorded(turns, 1)
    found = calibrate(replace(recording, scalar_T=recording.scalar_T + 50e-9 * direction[:, 0] ** 2), CROSS)
    size_nT = re.search("the scalar follows the direction of the field by ([0-9.]+) nT", " ".join(found.warnings))
    assert 15 < float(size_nT[1]) < 50


def test_what_a_scalar_follows_may_be_accepted():
    """As where an effect of the vehicle, which sensors and scalar share, is taken off: then all of it is used."""
    recording = read_beside(circles(), 1, 150e-9 * np.array([0.6, -0.64, 0.48]))
    found = calibrate(recording, CROSS, accept=["scalar"])
    assert not any("the scalar follows" in note for note in (*found.warnings, *found.notes))
    np.testing.assert_array_equal(found.errors.scale_factor, maximum_likelihood(recording, CROSS).errors.scale_factor)


def test_a_load_that_is_switched_as_the_array_turns_is_found():
    """Though its field is no polynomial of the direction."""
    turns = circles()
    is_on = turns.inv().apply([0.0, 19e-6, -45e-6])[:, 0] > 0
    found = calibrate(read_beside(turns, 2, is_on[:, None] * 50e-9 * np.array([0.6, -0.64, 0.48])), CROSS)
    assert any("only its mean is used" in note for note in (*found.warnings, *found.notes)) and worst(found) < 4


def test_a_sound_scalar_is_kept():
    """In 20 runs, with a drift of the field by 20 nT in every other."""
    for seed in range(20):
        turns = circles(count=600, period_s=20.0)
        recording = recorded(turns, seed)
        drift = (seed % 2) * 20e-9 * np.sin(np.linspace(0, 2, 600))
        factor = 1 + drift / 48.8e-6
        drifting = replace(
            recording, readings_T=recording.readings_T * factor[:, None, None], scalar_T=recording.scalar_T * factor
        )
        assert not any("the scalar" in note for note in calibrate(drifting, CROSS).notes)


def pulsating(period_s, size_T, seed):
    """Return a recording in which sensors and scalar read a field that pulsates."""
    recording, phase = recorded(circles(), seed), 2 * np.pi * np.arange(1200) / 10 / period_s
    factor = 1 + size_T / 48.8e-6 * np.sin(phase + seed)
    readings_T = (recording.readings_T - ERRORS.bias_T) * factor[:, None, None] + ERRORS.bias_T
    return replace(recording, readings_T=readings_T, scalar_T=recording.scalar_T * factor)


@pytest.mark.parametrize("period_s", [15.0, 30.0])
def test_a_field_that_pulsates_as_the_array_turns_misleads_by_no_more_than_is_told(period_s):
    """It cannot be told from a magnet beside the scalar: the standard errors hold both."""
    for seed in range(2):
        assert worst(calibrate(pulsating(period_s, 5e-9, seed), CROSS)) < 4


@pytest.mark.parametrize("size_T", [20e-9, 40e-9, 100e-9])
def test_a_scalar_that_reads_large_waves_of_the_field_is_used(size_T):
    """The quadric of the sensors' readings varies as the intensity does, and shows no magnet beside the scalar."""
    for seed in range(3):
        found = calibrate(pulsating(13.0, size_T, seed), CROSS)
        assert not any("the scalar" in note for note in found.notes) and worst(found) < 4


def test_a_scalar_that_turns_in_part_is_kept_with_wider_standard_errors():
    """Noise that lasts is most of what it reads."""
    recording = read_beside(circles(), 5, 3e-9 * np.array([0.6, -0.64, 0.48]))
    lasting_T = 3e-9 * np.random.default_rng(6).normal(size=1200)
    noisy = replace(CROSS, scalar_noise_T=3e-9)
    found = calibrate(replace(recording, scalar_T=recording.scalar_T + lasting_T), noisy)
    assert (
        any("and the standard errors include that" in note for note in (*found.warnings, *found.notes))
        and worst(found) < 4
    )


def test_a_source_that_sensors_and_scalar_share_does_not_look_like_a_magnet():
    """It stays for a part of a narrow turn."""
    time_s = np.arange(COUNT) / RATE_HZ
    near_T = np.outer((time_s > 100) & (time_s < 180), [80e-9, 0.0, 60e-9])
    recording, array, truth = made(4, seed=5, added_T=near_T)
    found = calibrate(replace(recording, angular_velocity_rad_s=None), array)
    assert (np.abs(found.errors.bias_T - truth.bias_T) < 4 * found.standard_errors[:, 6:9]).all()


def test_an_attitude_that_is_rejected_widens_no_error_beside_a_magnet():
    """Neither fit uses the inverse attitude, with the scalar as it is and with one that may follow the direction."""
    turns = circles()
    recording = replace(read_beside(turns, 1, 1.5e-9 * np.array([0.6, -0.64, 0.48])), attitude=turns.inv().as_quat())
    rejected = calibrate(recording, replace(CROSS, attitude_noise=from_degrees(0.1)))
    alone = calibrate(replace(recording, attitude=None), CROSS)
    assert any("the scalar follows the direction of the field" in one for one in (*rejected.warnings, *rejected.notes))
    assert_allclose(rejected.standard_errors, alone.standard_errors, rtol=0.01, atol=1e-15)


def test_a_gyroscope_that_is_mounted_askew_widens_no_error_beside_a_magnet():
    """Both fits are in the frame of the gyroscope, two degrees from that of sensor 1."""
    recording, array, _ = made(4, count=2000)
    field_T = attitude_at(recording.time_s, recording.time_s[-1]).inv().apply(WORLD_T)
    askew = Rotation.from_euler("x", 2.0, degrees=True).apply(recording.angular_velocity_rad_s)
    recording = replace(recording, angular_velocity_rad_s=askew)
    array = replace(array, mounting_error=from_degrees(0.05))
    magnet_T = 3e-9 * field_T[:, 0] / np.linalg.norm(field_T, axis=1)
    beside = replace(recording, scalar_T=recording.scalar_T + magnet_T)
    without, with_it = (calibrate(one, array) for one in (recording, beside))
    assert any("the scalar follows the direction of the field" in one for one in (*with_it.warnings, *with_it.notes))
    assert_allclose(with_it.standard_errors[:, 9:], without.standard_errors[:, 9:], rtol=0.05, atol=1e-9)
