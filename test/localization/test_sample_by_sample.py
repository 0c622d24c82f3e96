"""Samples by themselves: less the regional field, independent of each other, refused without attitude."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.turned_samples import (
    Regional,
    Samples,
    locate_samples,
    regional_of,
    turned,
)
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import from_degrees
from tam_calibration.sources.dipole import Dipole

EARTH_T = np.array([1e-6, 21e-6, -43e-6])
DIPOLE = Dipole(np.array([2.0, 1.5, -1.7]), np.array([50.0, -80.0, 120.0]))
ARRAY = Array.cross(0.5, 1e-10, 1e-10)
COVARIANCE = ARRAY.operator @ ARRAY.operator.T * 1e-20
PARTS = ("position_m", "position_covariance_m2", "moment_Am2", "moment_covariance_A2m4", "status")


def seen(count, earth_T=EARTH_T, noise_T=0.0, strength=1.0):
    """Return attitudes and outputs of an array that turns before the dipole, which may be stronger."""
    rng = np.random.default_rng(count)
    turns = Rotation.random(count, random_state=4)
    matrix = turns.as_matrix()
    world = earth_T + strength * DIPOLE.field_T(np.einsum("nij,kj->nki", matrix, ARRAY.positions_m))
    fields = np.einsum("nji,nkj->nki", matrix, world) + noise_T * rng.normal(size=world.shape)
    return turns.as_quat(), fields.reshape(count, -1) @ ARRAY.operator.T


def test_the_dipole_is_found_in_the_world():
    """Less the regional field every sample gives the same place and moment along the world's axes."""
    attitude, outputs = seen(20)
    own = locate_samples(Samples(outputs, ARRAY, COVARIANCE, attitude), Regional(EARTH_T))
    world = turned(own, attitude)
    assert world.is_located.all()
    assert_allclose(world.position_m, np.tile(DIPOLE.position_m, (20, 1)), rtol=1e-7)
    assert_allclose(world.moment_Am2, np.tile(DIPOLE.moment_Am2, (20, 1)), rtol=1e-7)
    trace = np.trace(own.position_covariance_m2, axis1=1, axis2=2)
    assert_allclose(np.trace(world.position_covariance_m2, axis1=1, axis2=2), trace, rtol=1e-9)


@pytest.mark.parametrize("index", [3.0, 2.0])
def test_a_sample_does_not_depend_on_its_neighbours(index):
    """Alone and among others a sample has the same numbers, to the last bit."""
    attitude, outputs = seen(4, noise_T=1e-10)

    def locate(part):
        samples = Samples(outputs[part], ARRAY, COVARIANCE, attitude[part], index)
        return turned(locate_samples(samples, Regional(EARTH_T, 1e-5)), attitude[part])

    together = locate(slice(None))
    alone = locate(slice(3, 4))
    for part in PARTS:
        assert_array_equal(getattr(alone, part)[0], getattr(together, part)[3])


def test_errors_of_the_attitude_are_in_the_covariance():
    """With attitudes that err by as much as stated the squared errors over their covariance are χ² of three."""
    noise, (attitude, outputs) = 1e-4, seen(2000, noise_T=1e-10)
    errors = Rotation.from_rotvec(noise * np.random.default_rng(8).normal(size=(2000, 3)))
    measured = (Rotation.from_quat(attitude) * errors).as_quat()
    own = locate_samples(Samples(outputs, ARRAY, COVARIANCE, measured), Regional(EARTH_T, noise))
    off = own.position_m - Rotation.from_quat(attitude).inv().apply(DIPOLE.position_m)
    chi_square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(own.position_covariance_m2), off)
    assert np.mean(chi_square) == pytest.approx(3, abs=4 * np.sqrt(6 / 2000))


def test_large_errors_of_the_attitude_are_in_the_covariance():
    """0.3° in 50 µT are 260 nT beside 0.03 nT of noise: what they are to the second order, 0.7 nT, is no error."""
    count, noise = 400, float(from_degrees(0.3))
    attitude, outputs = seen(count, noise_T=0.03e-9, strength=3)
    errors = Rotation.from_rotvec(noise * np.random.default_rng(9).normal(size=(count, 3)))
    measured = (Rotation.from_quat(attitude) * errors).as_quat()
    covariance = ARRAY.operator @ ARRAY.operator.T * 0.03e-9**2
    own = locate_samples(Samples(outputs, ARRAY, covariance, measured), Regional(EARTH_T, noise))
    located = own.is_located
    assert located.mean() > 0.5
    off = own.position_m - Rotation.from_quat(attitude).inv().apply(DIPOLE.position_m)
    chi_square = np.einsum("ni,nij,nj->n", off, np.linalg.inv(own.position_covariance_m2), off)[located]
    assert np.mean(chi_square) == pytest.approx(3, abs=5 * np.sqrt(6 / count))
    assert np.mean(chi_square > chi2.isf(0.01, 3)) < 0.02


def test_the_regional_field_s_covariance_is_in_that_of_the_samples():
    """With fields that err by as much as stated, not alike along the axes, the squared errors are χ² of three."""
    spread = np.array([[4.0, 3.0, 0.0], [3.0, 9.0, -2.0], [0.0, -2.0, 1.0]]) * 1e-18
    attitude, outputs = seen(300, noise_T=1e-10)
    found, chi_square = Rotation.from_quat(attitude).inv().apply(DIPOLE.position_m), []
    for field_T in np.random.default_rng(10).multivariate_normal(EARTH_T, spread, 60, tol=1e-20):
        part = slice(len(chi_square), len(chi_square) + 5)
        own = locate_samples(Samples(outputs[part], ARRAY, COVARIANCE, attitude[part]), Regional(field_T, 0.0, spread))
        assert own.is_located.all()
        off = own.position_m - found[part]
        chi_square.extend(np.einsum("ni,nij,nj->n", off, np.linalg.inv(own.position_covariance_m2), off))
    assert np.mean(chi_square) == pytest.approx(3, abs=4 * np.sqrt(6 / 60))


def test_unknown_attitude_is_the_reason():
    """A sample without attitude is refused for that, the others are not touched."""
    attitude, outputs = seen(3)
    attitude[1] = np.nan
    own = locate_samples(Samples(outputs, ARRAY, COVARIANCE, attitude), Regional(EARTH_T))
    assert turned(own, attitude).status.tolist() == own.status.tolist() == [0, Status.NO_ATTITUDE, 0]
    with pytest.raises(InputError, match="without an attitude"):
        locate_samples(Samples(outputs, ARRAY, COVARIANCE), Regional(EARTH_T))


def test_regional_field_is_what_most_samples_have():
    """A source in a third of the samples moves the median little; unknown samples do not count."""
    turns = Rotation.random(300, random_state=6)
    outputs = np.zeros((300, 9))
    outputs[:, :3] = turns.inv().apply(EARTH_T + 1e-9 * np.random.default_rng(2).normal(size=(300, 3)))
    outputs[:100, :3] += 1e-7
    outputs[150, 0] = np.nan
    found = regional_of(outputs, turns.as_quat())
    assert_allclose(found.field_T, EARTH_T, atol=3e-9)
    assert found.attitude_noise == 0
    with pytest.raises(InputError, match="cannot be fitted"):
        regional_of(np.full((3, 9), np.nan), turns.as_quat()[:3])


def drifting(drift_T, seed=3):
    """Return attitudes and outputs in a field that drifts in the world along the run, with 1 nT of noise."""
    turns = Rotation.random(1000, random_state=7)
    world = EARTH_T + np.outer(np.linspace(-0.5, 0.5, 1000), drift_T)
    outputs = np.zeros((1000, 9))
    outputs[:, :3] = turns.inv().apply(world + 1e-9 * np.random.default_rng(seed).normal(size=(1000, 3)))
    return turns.as_quat(), outputs


def test_the_regional_field_is_as_uncertain_as_the_run_is_long():
    """Tenths of a field that drifts by 100 nT differ by 10: median absolute deviation 25 nT times 1.48."""
    attitude, outputs = drifting([0.0, 100e-9, -40e-9])
    found = regional_of(outputs, attitude, 1e-3)
    errors = np.sqrt(np.diag(found.covariance_T2))
    assert_allclose(errors[1:], [37e-9, 14.8e-9], rtol=0.05)
    assert errors[0] < 0.5e-9
    assert found.attitude_noise == 1e-3


def test_the_regional_field_of_noise_is_no_more_certain_than_it_is():
    """Over many runs it is off by no more than its standard errors say, and these are a part of the noise's."""
    pulls, errors = [], []
    for seed in range(20):
        attitude, outputs = drifting(np.zeros(3), seed)
        found = regional_of(outputs, attitude)
        errors.append(np.sqrt(np.diag(found.covariance_T2)))
        pulls.append((found.field_T - EARTH_T) / errors[-1])
    assert np.sqrt(np.mean(np.square(pulls))) < 1
    assert np.mean(errors) < 0.3e-9


def test_errors_of_the_attitude_do_not_shorten_the_regional_field():
    """The median of what they turn is shorter by half of their square; that is put back."""
    noise, rng = 0.05, np.random.default_rng(11)
    turns = Rotation.random(200000, random_state=8)
    outputs = np.zeros((200000, 9))
    outputs[:, :3] = turns.inv().apply(np.tile(EARTH_T, (200000, 1)))
    measured = (turns * Rotation.from_rotvec(noise * rng.normal(size=(200000, 3)))).as_quat()
    length = np.linalg.norm(EARTH_T)
    found, plain = (regional_of(outputs, measured, each).field_T for each in (noise, 0.0))
    assert np.linalg.norm(found) == pytest.approx(length, rel=noise**2 / 8)
    assert np.linalg.norm(plain) == pytest.approx(length * (1 - noise**2 / 2), rel=noise**2 / 8)


def test_the_direction_of_a_line_is_that_of_the_world():
    """It is turned with the attitude."""
    turns = Rotation.random(12, random_state=5)
    own = EulerSolutions.refused(12, Status.LOCATED)
    own.along[:] = [0.6, 0.0, 0.8]
    world = turned(own, turns.as_quat())
    assert_allclose(world.along, turns.apply(own.along), atol=1e-12)
