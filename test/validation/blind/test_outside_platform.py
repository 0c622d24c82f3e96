"""Causes outside the library on the vehicle around a sensor."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.validation.blind.outside_platform import _dipole_at, _pulled, _slid


@pytest.mark.parametrize("name", ["cable_windup", "rubber_mount", "gyro_fusion"])
def test_what_turns_a_sensor_keeps_the_length_of_its_reading(change_of, name):
    """The error lies across the field."""
    scene, cause, change = change_of(name, 1)
    core = scene.core(cause.sensors[0] - 1)
    along = (change * core).sum(axis=1) / np.linalg.norm(core, axis=1)
    assert np.std(along) < 0.15 * np.std(change)


def test_a_tray_slides_to_its_stop():
    """It stays there until the rail slopes the other way."""
    assert_allclose(_slid(np.array([0.6, 0.6, 0.6, -0.5, -2.0])), [0.6, 1, 1, 0.5, -1])


def test_a_dipole_has_twice_the_field_on_its_axis():
    """And it is against the moment beside it."""
    field = _dipole_at(np.array([0, 0, 1.0]), np.array([[0, 0, 2.0], [2.0, 0, 0]]))
    assert_allclose(field, [[0, 0, 0.25], [0, 0, -0.125]])


def test_remanence_moves_slowly(change_of):
    """From one sample to the next it changes by a small part of all that it does."""
    _, _, change = change_of("viscous_remanence", 1)
    assert np.abs(np.diff(change, axis=0)).max() < 0.2 * np.ptp(change)


def test_a_charge_jumps_up_and_fades(change_of):
    """It rises in few samples only, and never beyond the full current."""
    _, _, change = change_of("sonar_recharge", 1)
    size = np.linalg.norm(change, axis=1)
    assert np.mean(np.diff(size) > 0) < 0.2 and size.max() <= 1.0001e-9


def test_what_has_play_rests_after_a_reversal():
    """It is pulled when the play is used up."""
    assert_allclose(_pulled(np.array([0.0, 1, 3, 2.5, 1.5, 0]), 1.0), [0, 0, 2, 2, 2, 1])
