"""Causes outside the library in what reads a sensor out."""

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.validation.blind.outside_instrument import _followed, _kept, _reported


def test_a_bit_is_set_or_not(change_of):
    """An axis has two errors and no other, and goes from one to the other often."""
    _, _, change = change_of("weak_bit", 1)
    for axis in change.T[np.ptp(change, axis=0) > 0]:
        assert len(np.unique(axis)) == 2 and np.count_nonzero(np.diff(axis)) > 20


def test_a_shared_reference_is_even_in_the_other_axes(change_of):
    """The gain error is of one sign, whatever the signs of the fields."""
    scene, cause, change = change_of("shared_reference", 1)
    core = scene.core(cause.sensors[0] - 1)
    assert (change * core <= 0).all()


def test_noise_of_a_reference_lies_along_the_reading(change_of):
    """All axes err by the same part of what they read."""
    scene, cause, change = change_of("reference_noise", 1)
    assert_allclose(np.cross(change, scene.core(cause.sensors[0] - 1)), 0, atol=1e-22)


def test_an_idle_tone_rests_in_a_zero_field(change_of):
    """It changes fast only where the field along its axis is large."""
    scene, cause, change = change_of("idle_tone", 1)
    step, size = np.abs(np.diff(change, axis=0)), np.abs(scene.core(cause.sensors[0] - 1)[1:])
    weak = size < 0.05
    assert step[weak].max() <= 2 * np.pi * 0.45 * 0.05 * 1.4e-9 < step.max()


def test_a_slow_integrator_catches_up():
    """It goes by its limit until it is there."""
    assert_allclose(_followed(np.array([0.0, 3, 3, 3, 3, 2.5]), np.ones(6)), [0, 1, 2, 3, 3, 2.5])


def test_what_stays_in_its_band_is_not_reported():
    """The last report stands until a value is off by more than the band."""
    assert_array_equal(_reported(np.array([0.0, 0.9, 1.1, 0.5, 0.2, 0.0]), 1.0), [0, 0, 1.1, 1.1, 1.1, 0])


def test_a_handover_is_late():
    """Within the band the cell is the one that it was."""
    assert_array_equal(_kept(np.array([-1.0, 0.1, 0.3, 0.1, -0.1, -0.3]), 0.2), [0, 0, 1, 1, 1, 0])
