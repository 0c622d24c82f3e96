"""Samples by themselves: less the regional field, independent of each other, refused without attitude."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.localization.sample_by_sample import Regional, locate_samples, regional_of, turned
from tam_calibration.localization.solutions import Status
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.sources.dipole import Dipole

EARTH_T = np.array([1e-6, 21e-6, -43e-6])
DIPOLE = Dipole(np.array([2.0, 1.5, -1.7]), np.array([50.0, -80.0, 120.0]))
ARRAY = Array.cross(0.5, 1e-10, 1e-10)
COVARIANCE = ARRAY.operator @ ARRAY.operator.T * 1e-20
PARTS = ("position_m", "position_covariance_m2", "moment_Am2", "moment_covariance_A2m4", "status")


def seen(count, earth_T=EARTH_T, noise_T=0.0):
    """Return attitudes and outputs of an array that turns before the dipole."""
    rng = np.random.default_rng(count)
    turns = Rotation.random(count, random_state=4)
    matrix = turns.as_matrix()
    world = earth_T + DIPOLE.field_T(np.einsum("nij,kj->nki", matrix, ARRAY.positions_m))
    fields = np.einsum("nji,nkj->nki", matrix, world) + noise_T * rng.normal(size=world.shape)
    return turns.as_quat(), fields.reshape(count, -1) @ ARRAY.operator.T


def test_the_dipole_is_found_in_the_world():
    """Less the regional field every sample gives the same place and moment along the world's axes."""
    attitude, outputs = seen(20)
    own = locate_samples(outputs, ARRAY, COVARIANCE, regional=Regional(EARTH_T), attitude=attitude)
    world = turned(own, attitude)
    assert world.is_located.all()
    assert_allclose(world.position_m, np.tile(DIPOLE.position_m, (20, 1)), rtol=1e-7)
    assert_allclose(world.moment_Am2, np.tile(DIPOLE.moment_Am2, (20, 1)), rtol=1e-7)
    trace = np.trace(own.position_covariance_m2, axis1=1, axis2=2)
    assert_allclose(np.trace(world.position_covariance_m2, axis1=1, axis2=2), trace, rtol=1e-9)


@pytest.mark.parametrize("index", [3.0, 2.0])
def test_a_sample_does_not_depend_on_its_neighbours(index):
    """Alone and among others a sample has the same numbers, to the last bit."""
    attitude, outputs = seen(60, noise_T=1e-10)

    def locate(part):
        settings = {"index": index, "regional": Regional(EARTH_T, 1e-5), "attitude": attitude[part]}
        return turned(locate_samples(outputs[part], ARRAY, COVARIANCE, **settings), attitude[part])

    together = locate(slice(None))
    for index_of_sample in range(60):
        alone = locate(slice(index_of_sample, index_of_sample + 1))
        for part in PARTS:
            assert_array_equal(getattr(alone, part)[0], getattr(together, part)[index_of_sample])


def test_errors_of_the_attitude_are_in_the_covariance():
    """With attitudes that err by as much as stated the squared errors over their covariance are χ² of three."""
    noise, (attitude, outputs) = 1e-4, seen(2000, noise_T=1e-10)
    errors = Rotation.from_rotvec(noise * np.random.default_rng(8).normal(size=(2000, 3)))
    measured = (Rotation.from_quat(attitude) * errors).as_quat()
    own = locate_samples(outputs, ARRAY, COVARIANCE, regional=Regional(EARTH_T, noise), attitude=measured)
    off = own.position_m - Rotation.from_quat(attitude).inv().apply(DIPOLE.position_m)
    chi_square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(own.position_covariance_m2), off)
    assert np.mean(chi_square) == pytest.approx(3, abs=4 * np.sqrt(6 / 2000))


def test_unknown_attitude_is_the_reason():
    """A sample without attitude is refused for that, the others are not touched."""
    attitude, outputs = seen(3)
    attitude[1] = np.nan
    own = locate_samples(outputs, ARRAY, COVARIANCE, regional=Regional(EARTH_T), attitude=attitude)
    assert turned(own, attitude).status.tolist() == own.status.tolist() == [0, Status.NO_ATTITUDE, 0]
    with pytest.raises(InputError, match="without an attitude"):
        locate_samples(outputs, ARRAY, COVARIANCE, regional=Regional(EARTH_T))


def test_regional_field_is_what_most_samples_have():
    """A source in a third of the samples moves the median little; unknown samples do not count."""
    turns = Rotation.random(300, random_state=6)
    outputs = np.zeros((300, 9))
    outputs[:, :3] = turns.inv().apply(EARTH_T + 1e-9 * np.random.default_rng(2).normal(size=(300, 3)))
    outputs[:100, :3] += 1e-7
    outputs[150, 0] = np.nan
    assert_allclose(regional_of(outputs, turns.as_quat()), EARTH_T, atol=3e-9)
    with pytest.raises(InputError, match="cannot be fitted"):
        regional_of(np.full((3, 9), np.nan), turns.as_quat()[:3])
