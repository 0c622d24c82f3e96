"""A steady source from each sample by itself."""

import numpy as np
import pytest
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.localization.locate import locate_steady
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.sources.dipole import Dipole

from .conftest import calibration_of

ARRAY = Array.cross(0.5, vector_noise_T=1e-9)
TIME_S = np.arange(300) / 5
POSITION_M = np.outer(TIME_S - 30.0, [1.0, 0.0, 0.0])
SOURCE = Dipole(np.array([2.0, 3.0, -2.5]), np.array([100.0, 200.0, -300.0]))
REGIONAL = np.array([1e-6, 2e-5, -4.5e-5])
SWAY = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(TIME_S, [0.2, 0.33, 0.5])))


def passed(seed):
    """Return the recording of a platform that sways as it passes."""
    matrix = SWAY.as_matrix()
    points = POSITION_M[:, None] + np.einsum("nij,kj->nki", matrix, ARRAY.positions_m)
    fields = np.einsum("nji,nkj->nki", matrix, SOURCE.field_T(points) + REGIONAL)
    noise = 1e-9 * np.random.default_rng(seed).normal(size=fields.shape)
    return Recording(TIME_S, fields + noise, attitude=SWAY.as_quat())


def test_samples_near_the_dipole_find_it_by_themselves():
    """Places count from the array; each lies within what its covariance says, and the far ones are refused."""
    survey = locate_steady(
        passed(36), calibration_of(ARRAY), regional_T=REGIONAL, regional_covariance_T2=np.zeros((3, 3))
    )
    located = survey.solutions.is_located
    assert 20 < located.sum() < 250
    nearest = np.argmin(norm(POSITION_M - SOURCE.position_m, axis=1))
    assert located[nearest - 5 : nearest + 5].all()
    off = survey.solutions.position_m[located] + POSITION_M[located] - SOURCE.position_m
    assert norm(np.median(off, axis=0)) < 0.1
    variance = np.trace(survey.solutions.position_covariance_m2[located], axis1=1, axis2=2)
    assert np.mean(np.sum(off**2, axis=1) / variance) == pytest.approx(1, abs=0.4)


def test_without_attitude_the_regional_field_stays():
    """The sentence says so."""
    recording = passed(37)
    with pytest.raises(InputError, match="has no attitude"):
        locate_steady(Recording(recording.time_s, recording.readings_T), calibration_of(ARRAY))
