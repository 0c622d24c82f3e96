import warnings

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose

from tam_calibration.localization import turned_samples
from tam_calibration.localization.euler import locate
from tam_calibration.localization.solutions import Status
from tam_calibration.localization.source_fit import whitening_of
from tam_calibration.localization.turned_samples import Samples, locate_each
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.sources.dipole import dipole_field

ARRAY = Array.cross(0.21, vector_noise_T=5e-11)
NOISE = ARRAY.operator @ ARRAY.operator.T * 2.5e-21
RANGE_M = 2.64


def located(outputs, noise=1e-9 * NOISE, array=ARRAY):
    """Return the sources of outputs that are those of sources alone; by default they are nearly exact."""
    return locate_each(Samples(outputs, array, noise))


@pytest.fixture(scope="module")
def dipoles():
    """Return places 2.64 m away, moments, and the readings (N, K, 3) that they make."""
    generator = np.random.default_rng(11)
    places = generator.normal(size=(300, 3))
    places *= RANGE_M / norm(places, axis=1, keepdims=True)
    moments = 250 * generator.normal(size=(300, 3))
    return places, moments, dipole_field(ARRAY.positions_m - places[:, None], moments[:, None])[0]


def test_error_of_finite_baselines_is_gone(dipoles):
    """Euler's solution is wrong by per cents of the range, and the fit with the true baselines by nothing."""
    places, moments, readings = dipoles
    outputs = readings.reshape(len(places), -1) @ ARRAY.operator.T
    euler, found = locate(outputs), located(outputs)
    assert norm(euler.position_m - places, axis=1).max() > 0.02 * RANGE_M
    assert found.is_located.all()
    assert_allclose(found.position_m, places, atol=1e-10)
    assert_allclose(found.moment_Am2, moments, atol=1e-7)


def test_covariance_is_that_of_repeated_measurements(dipoles):
    """And no larger than Euler's, which leaves out two of the eight outputs."""
    places, _, readings = dipoles
    noisy = readings[:1] + 5e-11 * np.random.default_rng(12).normal(size=(4000, 4, 3))
    outputs = noisy.reshape(len(noisy), -1) @ ARRAY.operator.T
    found = located(outputs, NOISE)
    one = located(readings[:1].reshape(1, -1) @ ARRAY.operator.T, NOISE)
    covariance = one.position_covariance_m2[0]
    size = np.sqrt(np.diag(covariance))
    assert_allclose(np.cov(found.position_m.T) / np.outer(size, size), covariance / np.outer(size, size), atol=0.08)
    assert_allclose(found.position_m.mean(axis=0), places[0], atol=4 * size.max() / np.sqrt(4000))
    assert np.trace(covariance) <= np.trace(locate(outputs[:1], NOISE).position_covariance_m2[0])


def test_refused_samples_keep_their_reason_and_disturb_no_other(dipoles):
    """Each sample stands alone, with a covariance of its own or a common one."""
    places, _, readings = dipoles
    outputs = readings[:4].reshape(4, -1) @ ARRAY.operator.T
    outputs[1] = np.nan
    for noise in (NOISE, np.broadcast_to(NOISE, (4, 9, 9))):
        found = located(outputs, noise)
        assert found.status.tolist() == [Status.LOCATED, Status.NOT_FINITE, Status.LOCATED, Status.LOCATED]
        assert np.isnan(found.position_m[1]).all()
        assert_allclose(found.position_m[[0, 2, 3]], places[[0, 2, 3]], atol=1e-10)
        for n in (0, 2, 3):
            alone = located(outputs[n : n + 1], NOISE)
            assert_allclose(alone.position_m[0], found.position_m[n], rtol=1e-12)


def test_many_samples_are_located_as_few_are(dipoles, monkeypatch):
    """Cut into pieces, each sample gives what it gives in one, with one covariance or one for each."""
    outputs = dipoles[2].reshape(300, -1) @ ARRAY.operator.T
    whole = located(outputs, NOISE)
    monkeypatch.setattr(turned_samples, "BLOCK", 70)
    for noise in (NOISE, np.broadcast_to(NOISE, (300, 9, 9))):
        cut = located(outputs, noise)
        assert_allclose(cut.position_m, whole.position_m, rtol=1e-12)
        assert_allclose(cut.position_covariance_m2, whole.position_covariance_m2, rtol=1e-9)
        assert cut.status.tolist() == whole.status.tolist()


def test_without_a_located_sample_the_reasons_are_told(dipoles):
    """All not finite, and none at all."""
    found = located(np.full((2, 9), np.nan), np.full((9, 9), np.nan))
    assert found.status.tolist() == [Status.NOT_FINITE, Status.NOT_FINITE]
    assert located(np.zeros((0, 9)), NOISE).position_m.shape == (0, 3)


def test_what_cannot_be_weighed_is_refused(dipoles):
    """By an array without gradient, and a covariance that is none."""
    outputs = dipoles[2][:1].reshape(1, -1) @ ARRAY.operator.T
    assert located(outputs, array=Array(np.eye(3)[:2])).status.tolist() == [Status.NOT_FINITE]
    with pytest.raises(InputError, match="positive, finite diagonal"):
        located(outputs, np.zeros((9, 9)))


def test_places_of_the_axes_are_part_of_the_model(dipoles):
    """Each axis reads its component where its element sits: the dipole comes out exactly all the same."""
    places, moments, _ = dipoles
    offsets = 0.01 * np.random.default_rng(13).normal(size=(4, 3, 3))
    array = Array(ARRAY.positions_m, axis_offsets_m=offsets)
    fields = dipole_field(array.element_positions_m - places[:, None, None], moments[:, None, None])[0]
    readings = np.diagonal(fields.reshape(len(places), 4, 3, 3), axis1=2, axis2=3)
    found = located(readings.reshape(len(places), -1) @ array.operator.T, array=array)
    assert_allclose(found.position_m, places, atol=1e-9)


def test_noise_that_leads_steps_far_away_is_no_warning(cross):
    """Outputs without any source take some fits to infinity: that is refused in order, not warned of."""
    outputs = np.random.default_rng(0).normal(0, 1e-9, (2000, 12)) @ cross.operator.T
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        located(outputs, array=cross)


@pytest.mark.parametrize("shape", [(), (3,)])
def test_whitened_outputs_have_the_covariance_one(shape):
    """Of one covariance or several, with fields and gradients of very different size."""
    roots = np.random.default_rng(14).normal(size=(*shape, 8, 8)) * np.repeat([1e-9, 1e-12], [3, 5])[:, None]
    noise = roots @ np.swapaxes(roots, -1, -2)
    root = whitening_of(noise)
    assert_allclose(root @ noise @ np.swapaxes(root, -1, -2), np.broadcast_to(np.eye(8), (*shape, 8, 8)), atol=1e-9)
