import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_validation.blind.catalogue import CATALOGUE
from tam_validation.blind.visible import NominalModel, scale_to


def fitted_residual(scene, vectors, scalar):
    """Return the whitened residual of the nominal model by a nonlinear fit of all unknowns, fields included."""
    samples, sensors = vectors.shape[:2]
    upper = np.triu_indices(3)

    def residual(unknowns):
        field, bias, first, others = np.split(unknowns, np.cumsum([3 * samples, 3 * sensors, 6]))
        field = field.reshape(samples, 3)
        response = np.zeros((sensors, 3, 3))
        response[0][upper] = first
        response[1:] = others.reshape(-1, 3, 3)
        read = np.einsum("kij,nj->nki", response, field) + bias.reshape(sensors, 3) * 0.1
        noise = scene.vector_noise_T / scale, scene.scalar_noise_T / scale
        return np.concatenate(
            [((vectors / scale - read) / noise[0]).ravel(), (scalar / scale - np.linalg.norm(field, axis=1)) / noise[1]]
        )

    scale = scene.intensity_T.mean()
    start = [scene.field_T / scale, scene.bias_T / scale * 10, scene.response[0][upper], scene.response[1:]]
    start = np.concatenate([part.ravel() for part in start])
    return least_squares(residual, start, method="trf", x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12).fun


@pytest.mark.parametrize("effect", ["bias_jump", "geomagnetic_drift", "time_skew"])
def test_visible_gap_is_what_a_full_nonlinear_fit_leaves(draw, effect):
    """The gap that a case is scaled to is the residual of a fit of fields and parameters to noise-free data."""
    scene = draw(3, samples=50)
    model = NominalModel(scene)
    clean = (scene.readings_T, scene.intensity_T)
    scaled = scale_to(model, CATALOGUE[effect].draw(np.random.default_rng(8), scene), 1.0, clean)
    left = fitted_residual(scene, clean[0] + scaled.signal[0], clean[1] + scaled.signal[1])
    assert_allclose(np.sqrt((left**2).sum() / (50 * 10)), 1.0, rtol=0.02)


def test_the_nominal_model_takes_up_its_own_parameters(draw):
    """Wrong scale factors, biases and angles are no gap."""
    scene = draw(4)
    change = np.random.default_rng(1).normal(size=(4, 3, 3))
    change[0][np.tril_indices(3, -1)] = 0
    vectors = np.einsum("kij,nj->nki", change, scene.field_T) * 1e-4 + 1e-8
    assert NominalModel(scene).visible_gap((vectors, np.zeros(scene.sample_count))) < 1e-6


def test_a_field_that_all_see_is_no_gap(draw):
    """What sensors and scalar see alike is the field."""
    scene = draw(5)
    extra = np.random.default_rng(2).normal(size=(scene.sample_count, 3)) * 1e-9
    vectors = scene.through(np.repeat(extra[:, None], 4, axis=1))
    scalar = (extra * scene.field_T).sum(axis=1) / scene.intensity_T
    assert NominalModel(scene).visible_gap((vectors, scalar)) < 1e-6


def test_white_noise_is_one_floor(draw):
    """The promised noise itself is one noise floor, the parameters' part of it taken up."""
    scene = draw(6, samples=2000)
    rng = np.random.default_rng(3)
    noise = rng.normal(size=(2000, 4, 3)) * scene.vector_noise_T, rng.normal(size=2000) * scene.scalar_noise_T
    assert_allclose(NominalModel(scene).visible_gap(noise), np.sqrt(1 - 45 / 20000), atol=4 / np.sqrt(2 * 20000))
