"""The regional field beside a line of current, and what is no run of one source."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.localization.one_source import locate_run, regional_beside_current
from tam_calibration.localization.turned_samples import (
    Regional,
    Samples,
    locate_samples,
    regional_of,
    turned,
)
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused

EARTH_T = np.array([1e-6, 20e-6, -45e-6])
ARRAY = Array.cross(0.5, vector_noise_T=1e-10)
NOISE = ARRAY.operator @ ARRAY.operator.T * 1e-20
PATH_M = np.outer(np.linspace(-10, 10, 60), [1.0, 0.2, 0.0])
SWAY = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(np.arange(60), [0.2, 0.33, 0.5])))
DEPTHS_M = (3.0, 2.5)


def passed(seed, places_m=(0.0,), gradient_T_per_m=0.0):
    """Return the outputs of a platform that passes currents of 10 A along y, 3 and 2.5 m below."""
    points = PATH_M[:, None] + np.einsum("nij,kj->nki", SWAY.as_matrix(), ARRAY.positions_m)
    world = EARTH_T + gradient_T_per_m * points * [1.0, 0.0, -1.0]
    for place, depth in zip(places_m, DEPTHS_M, strict=False):
        across = (points - [place, 0.0, -depth]) * [1.0, 0.0, 1.0]
        world = world + 2e-6 * np.cross([0.0, 1.0, 0.0], across) / np.sum(across**2, axis=2, keepdims=True)
    fields = np.einsum("nji,nkj->nki", SWAY.as_matrix(), world)
    fields += 1e-10 * np.random.default_rng(seed).normal(size=fields.shape)
    return fields.reshape(60, -1) @ ARRAY.operator.T


def located(outputs):
    """Return the regional field beside a current, and the samples with it."""
    attitude = SWAY.as_quat()
    samples = Samples(outputs, ARRAY, NOISE, attitude, 1)
    regional = regional_beside_current(samples, regional_of(outputs, attitude))
    own = locate_samples(samples, regional)
    return regional, turned(own, attitude)


def test_the_regional_field_is_found_beside_a_current():
    """The median of the run is off by tens of nT; what is found is off by its standard errors, which are below 3 nT."""
    pulls = []
    for seed in range(4):
        outputs = passed(seed)
        assert np.abs(regional_of(outputs, SWAY.as_quat()).field_T - EARTH_T).max() > 20e-9
        regional, world = located(outputs)
        errors = np.sqrt(np.diag(regional.covariance_T2))
        assert errors.max() < 3e-9
        pulls.append((regional.field_T - EARTH_T) / errors)
        off = world.position_m + PATH_M - [0.0, 0.0, -3.0]
        off[:, 1] = 0.0
        at = world.is_located
        spread = np.sqrt(np.diagonal(world.position_covariance_m2[at], axis1=1, axis2=2))
        assert np.abs(off[at][:, [0, 2]] / spread[:, [0, 2]]).max() < 5
    assert 0.6 < np.sqrt(np.mean(np.square(pulls))) < 1.5


@pytest.mark.parametrize(("places", "gradient"), [((0.0,), 2e-9), ((-4.0, 4.0), 0.0)])
def test_what_is_no_single_current_in_a_uniform_field_is_refused(places, gradient):
    """A gradient of the regional field, and a second current."""
    outputs, attitude = passed(3, places, gradient), SWAY.as_quat()
    with pytest.raises(Refused, match=r"line of current (at rest )?beside a uniform regional field|too few to tell"):
        locate_run(Samples(outputs, ARRAY, NOISE, attitude, 1), regional_of(outputs, attitude))


def test_a_run_without_a_current_is_refused():
    """No sample can be located, whatever the regional field."""
    outputs, attitude = passed(4, ()), SWAY.as_quat()
    prior = Regional(EARTH_T, covariance_T2=1e-16 * np.eye(3))
    with pytest.raises(Refused, match="none can be located"):
        regional_beside_current(Samples(outputs, ARRAY, NOISE, attitude, 1), prior)
