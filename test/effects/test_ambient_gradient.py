"""What a gradient of the world adds in the array frame."""

from dataclasses import replace

import numpy as np
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.effects.surroundings import AmbientGradient
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, UNIT_TENSORS, Array
from tam_calibration.model.fitted_effect import ALL, Contribution, FittedEffect

GRADIENT = 1e-9 * np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])


def test_the_basis_spans_symmetric_trace_free_tensors():
    """Five components make any such tensor, and are its own."""
    assert_allclose(np.tensordot(GRADIENT[TENSOR_ROWS, TENSOR_COLUMNS], UNIT_TENSORS, 1), GRADIENT, atol=1e-24)


def test_the_effect_is_the_gradient_of_a_simulated_site(turning):
    """Its terms of degree 2 add, at sensors and scalar, what the gradient adds along the position in the world."""
    covariates, weak = turning(samples=60), GRADIENT / 100
    names = ("xx", "xy", "xz", "yy", "yz")
    values = {f"gradient {name}": value for name, value in zip(names, weak[TENSOR_ROWS, TENSOR_COLUMNS], strict=True)}
    fitted = FittedEffect("ambient_gradient", {}, (Contribution(ALL, None, "degree 2", values),))
    rows = np.column_stack([covariates.sensed_T + covariates.errors.bias_T.ravel(), covariates.intensity_T])
    added = AmbientGradient().add(rows, covariates, fitted, np.random.default_rng(1)) - rows
    rotation, array = Rotation.from_quat(covariates.attitude), covariates.array
    change_T = [rotation.inv().apply(rotation.apply(position) @ weak) for position in array.positions_m]
    read_T = np.einsum("kij,knj->nki", covariates.errors.matrix, change_T).reshape(60, -1)
    assert_allclose(added[:, :-1], read_T, atol=1e-18)
    at_scalar = rotation.inv().apply(rotation.apply(array.scalar_position_m) @ weak)
    longer_T = np.linalg.norm(covariates.field_T + at_scalar, axis=1) - covariates.intensity_T
    assert_allclose(added[:, -1], longer_T, rtol=0, atol=1e-13)


def test_a_dipole_at_some_distance_is_within_the_terms(turning):
    """Two metres from a cross of half a metre the degrees 2 to 4 leave a hundredth of its field."""
    covariates = turning(samples=300)
    source, moment = np.array([1.2, 0.9, -1.4]), np.array([2.0, -1.0, 3.0])

    def field(position):
        away = position - source
        distance = np.linalg.norm(away, axis=1, keepdims=True)
        return 1e-7 * (3 * away * (away @ moment)[:, None] / distance**5 - moment / distance**3)

    rotation = Rotation.from_quat(covariates.attitude)
    change = [
        rotation.inv().apply(field(rotation.apply(at)) - field(np.zeros((1, 3)))) for at in covariates.array.positions_m
    ]
    signal = np.einsum("kij,knj->nki", covariates.errors.matrix, change).reshape(300, -1)
    terms = list(AmbientGradient().terms(covariates, {}))
    basis = np.column_stack(
        [term.signal(one, 13)[:, :-1].ravel() for term in terms for one in np.eye(len(term.coefficients))]
    )
    basis = basis / np.abs(basis).max(axis=0)
    left = signal.ravel() - basis @ np.linalg.lstsq(basis, signal.ravel(), rcond=None)[0]
    assert np.linalg.norm(left) < 0.01 * np.linalg.norm(signal)


def test_where_no_gradient_can_be_seen(turning):
    """Neither an array at rest nor a sensor in the centre of rotation shows it."""
    covariates = turning()
    assert AmbientGradient().obstacle(covariates) is None
    rest = turning(attitude=np.tile([0.0, 0.6, 0.0, 0.8], (1200, 1)))
    assert "the attitude changes by" in AmbientGradient().obstacle(rest)
    middle = replace(turning(sensors=1), array=Array(np.zeros((1, 3)), np.array([1e-9]), 1e-10))
    assert "centre of rotation" in AmbientGradient().obstacle(middle)
