"""Attitude with a gyroscope: it errs less, by its stated standard error; a gyroscope that disagrees is left out."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, RotationSpline

from tam_calibration.localization.line_path import attitude_path
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.recording import Recording

TIME_S = np.arange(1000) / 10
STATED = Gyroscope(np.radians(0.004), np.radians(3.0))


def turned(seed, error_deg=1.0, late_s=0.0, mounting_deg=0.0, stated=STATED):
    """Return a swaying array whose attitude errs for five seconds, with its angular velocity, and its true attitude."""
    generator = np.random.default_rng(seed)
    phase = generator.uniform(0, 6, 3)
    true = Rotation.from_euler("zyx", 0.08 * np.sin(np.outer(TIME_S, [0.9, 0.7, 1.1]) + phase))
    error = generator.standard_normal((len(TIME_S), 3))
    for number in range(1, len(error)):
        error[number] = 0.98 * error[number - 1] + np.sqrt(1 - 0.98**2) * error[number]
    reported = true * Rotation.from_rotvec(np.radians(error_deg) * error)
    rates = RotationSpline(TIME_S, true)(np.maximum(TIME_S - late_s, 0.0), 1)
    mounting = Rotation.from_rotvec(np.radians(mounting_deg) * np.array([0.6, 0.0, 0.8]))
    measured = stated.readings(TIME_S, mounting.apply(rates), generator)
    readings = np.full((len(TIME_S), 1, 3), 3e-5)
    recording = Recording(TIME_S, readings, attitude=reported.as_quat(), angular_velocity_rad_s=measured)
    return recording, true


def no_wander(attitude):
    """Return that the field is constant in the world of any attitude."""
    return 0.0


def error_of(path, true):
    """Return the root mean square error of an attitude about each axis, radians."""
    return np.sqrt(np.mean((Rotation.from_quat(path.attitude) * true.inv()).as_rotvec() ** 2))


@pytest.mark.parametrize("faults", [{}, {"late_s": 0.05, "mounting_deg": 2.0}])
def test_the_error_shrinks_to_its_standard_error(faults):
    """Over six lines the errors agree with their standard error, with any bias, delay and mounting."""
    ratios = []
    for seed in range(6):
        recording, true = turned(seed, **faults)
        path = attitude_path(recording, STATED, np.radians(1.0), no_wander)
        assert path.error < np.radians(0.7)
        assert "with the angular velocity" in path.note
        ratios.append(error_of(path, true) / path.error)
    assert 0.7 < np.sqrt(np.mean(np.square(ratios))) < 1.3


def test_without_stated_errors_they_are_estimated():
    """Neither the attitude's error nor the gyroscope's noise is stated."""
    recording, true = turned(3)
    path = attitude_path(recording, None, 0.0, no_wander)
    assert path.error < np.radians(0.7) and error_of(path, true) < 2.5 * path.error


def test_a_gyroscope_in_other_axes_is_left_out():
    """Turned by a right angle it does not turn as the attitude does, and the attitude stays as it was recorded."""
    recording, _ = turned(1, mounting_deg=90.0)
    path = attitude_path(recording, STATED, np.radians(1.0), no_wander)
    assert_allclose(path.attitude, recording.attitude)
    assert path.error == np.radians(1.0) and "does not turn as the attitude does" in path.note


def test_a_gyroscope_with_which_the_field_wanders_is_left_out():
    """The direction of the field, which no gyroscope knows, is steadier in the world of the recorded attitude."""
    recording, _ = turned(6)
    path = attitude_path(
        recording, STATED, 0.02, lambda attitude: 1.0 + (not np.array_equal(attitude, recording.attitude))
    )
    assert_allclose(path.attitude, recording.attitude)
    assert "does not turn as the attitude does" in path.note


def test_a_gyroscope_worse_than_the_attitude_changes_nothing():
    """Noise of a degree in a second adds nothing to an attitude that is exact to a hundredth of a degree."""
    recording, _ = turned(2, error_deg=0.01, stated=Gyroscope(np.radians(1.0), np.radians(3.0)))
    path = attitude_path(recording, None, np.radians(0.01), no_wander)
    assert_allclose(path.attitude, recording.attitude)
    assert path.note == ""


@pytest.mark.parametrize(("kept", "unknown"), [(1000, slice(300, 400)), (1000, slice(300, 306)), (90, slice(0, 0))])
def test_gaps_and_few_samples_are_told(kept, unknown):
    """A tenth of the angular velocities is missing, six that follow each other, or there are ninety only."""
    recording, _ = turned(4)
    recording = recording.take(slice(0, kept))
    rates = recording.angular_velocity_rad_s.copy()
    rates[unknown] = np.nan
    path = attitude_path(replace(recording, angular_velocity_rad_s=rates), STATED, 0.01, no_wander)
    assert "has gaps or few samples" in path.note
    assert_allclose(path.attitude, recording.attitude)


def test_single_missing_angular_velocities_are_bridged():
    """One in two hundred is missing: the error shrinks as without gaps."""
    recording, true = turned(4)
    rates = recording.angular_velocity_rad_s.copy()
    rates[100::200] = np.nan
    path = attitude_path(replace(recording, angular_velocity_rad_s=rates), STATED, np.radians(1.0), no_wander)
    assert path.error < np.radians(0.7) and error_of(path, true) < 2.5 * path.error


def test_without_a_gyroscope_the_attitude_is_the_recorded_one():
    """Nothing is said either."""
    recording, _ = turned(5)
    path = attitude_path(replace(recording, angular_velocity_rad_s=None), STATED, 0.02, no_wander)
    assert_allclose(path.attitude, recording.attitude)
    assert path.error == 0.02 and path.note == ""
