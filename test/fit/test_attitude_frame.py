from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.exceptions import InputError
from tam_calibration.fit.attitude_frame import into_array_frame
from tam_calibration.fit.integrated import integrated
from tam_calibration.reproduce import chi2017


@pytest.fixture(scope="module")
def case():
    """Return the simulation of Chi 2017, whose soft iron turns the frame of sensor 1 by tens of degrees."""
    return chi2017.set_up()


@pytest.fixture(scope="module")
def exact(case):
    """Return its recording without noise."""
    return replace(case.recording, readings_T=case.errors.distort(case.field_T))


@pytest.fixture(scope="module")
def blind(case, exact):
    """Return the calibration of the recording without noise and without attitude."""
    return integrated(replace(exact, attitude=None), case.array)


def test_attitude_takes_the_turn_off(case, exact, blind):
    """Without noise the errors in the array frame are found, the misalignment of sensor 1 with them."""
    found = into_array_frame(blind.errors, exact)
    assert_allclose(found.matrix, case.errors.matrix, rtol=0, atol=1e-12)
    assert_allclose(found.misalignment[0], case.errors.misalignment[0], rtol=0, atol=1e-12)


def test_only_a_gradient_sees_the_turn(case, exact, blind):
    """The tensor of a source is wrong in the frame of sensor 1, and right in the array frame."""
    gradient = 1e-6 * np.array([[1.0, 0.5, -0.3], [0.5, -0.2, 0.7], [-0.3, 0.7, -0.8]])
    field = case.field_T[:, None] + case.array.positions_m @ gradient
    expected = gradient[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]
    wrong = blind.apply(case.errors.distort(field))[:, 3:8]
    assert np.abs(wrong - expected).max() > 0.2e-6
    turned = replace(blind, errors=into_array_frame(blind.errors, exact))
    assert_allclose(turned.apply(case.errors.distort(field))[:, 3:8], np.tile(expected, (200, 1)), rtol=0, atol=1e-15)


def test_noise_of_the_attitude_averages_out(case, exact, blind):
    """With one degree of noise in the attitude the frame is found to a third of a degree."""
    noise = Rotation.from_rotvec(np.random.default_rng(6).normal(scale=0.0175, size=(200, 3)))
    noisy = replace(exact, attitude=(Rotation.from_quat(exact.attitude) * noise).as_quat())
    found = into_array_frame(blind.errors, noisy)
    error = Rotation.from_matrix(found.rotation[0] @ case.errors.rotation[0].T).magnitude()
    assert error < 0.006


def test_without_attitude_the_frame_is_not_to_be_found(case, exact):
    """A recording without attitude, and one that was turned about one axis only, are refused."""
    errors = case.errors
    with pytest.raises(InputError, match="no attitude"):
        into_array_frame(errors, replace(exact, attitude=None))
    steps = Rotation.from_euler("z", np.linspace(0, 6, 200)[:, None])
    field = steps.inv().apply(case.field_T[0])
    turned = replace(exact, readings_T=errors.distort(field), attitude=steps.as_quat())
    with pytest.raises(InputError, match="two axes"):
        into_array_frame(errors, turned)
