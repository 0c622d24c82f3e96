"""The Cramér–Rao bound: the smallest covariance that an unbiased estimate can have."""

import numpy as np

from tam_calibration.array import Array
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.scale import free_scale_gradient
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.units import FloatArray


def bound(field_T: FloatArray, errors: SensorErrors, array: Array, has_scalar: bool) -> FloatArray:
    """Return the smallest covariance of the parameters for given fields.

    Parameters
    ----------
    field_T : (N, 3) array
        Uniform fields in the array frame, tesla.
    errors : SensorErrors
        The truth; the misalignment of sensor 1 counts as known, see ``Calibration.statements``.
    array : Array
        With every noise stated.
    has_scalar : bool
        Whether each field's intensity was read with the array's scalar noise. Otherwise the intensity is an unknown
        constant, the scale is free and the mean determinant is fixed.

    Returns
    -------
    (12 K, 12 K) array
        In the order of ``SensorErrors.to_vector`` flattened, SI; infinite on the diagonal where undetermined.
    """
    assert array.vector_noise_T is not None
    assert array.scalar_noise_T is not None
    intensity = np.linalg.norm(field_T, axis=1)
    unit = float(intensity.mean())
    scalar_noise = array.scalar_noise_T / unit if has_scalar else 0.0
    likelihood = Likelihood(errors.distort(field_T) / unit, intensity / unit, array.vector_noise_T / unit, scalar_noise)
    point = likelihood.linearize(errors.matrix, errors.bias_T / unit)
    return parameter_covariance(point.information, errors, unit, None if has_scalar else unit)


def parameter_covariance(
    information: FloatArray, errors: SensorErrors, unit_T: float, free_intensity_T: float | None
) -> FloatArray:
    """Return the covariance of the parameters from the information of the rows [D Λ | o].

    Parameters
    ----------
    information : (12 K, 12 K) array
        Of the rows [D Λ | o], fields and biases in units of ``unit_T``.
    errors : SensorErrors
        Where it was linearised.
    unit_T : float
        Unit of field of the information, tesla.
    free_intensity_T : float, optional
        The fitted constant intensity where no scalar reference fixes the scale.

    Returns
    -------
    (12 K, 12 K) array
        Zero for the fixed misalignment of sensor 1, infinite on the diagonal where the data leave a parameter open.
    """
    count = errors.sensor_count
    # Without a reference the rows of D Λ enter times the intensity F: d(F D Λ) = F d(D Λ) + D Λ dF.
    factor = 1.0 if free_intensity_T is None else free_intensity_T / unit_T
    jacobian: FloatArray = _block_diagonal(errors.jacobian() * np.array([factor, factor, factor, 1 / unit_T])[:, None])
    free = np.ones(12 * count, dtype=bool)
    free[9:12] = False
    basis: FloatArray = np.eye(12 * count)[:, free]
    if free_intensity_T is not None:
        by_intensity = np.concatenate([errors.matrix, np.zeros((count, 3, 1))], axis=2).reshape(-1, 1)
        jacobian = np.hstack([jacobian, by_intensity])
        basis = _kept(np.append(free_scale_gradient(errors), 0.0), np.append(free, True))
    covariance = _invert(jacobian.T @ information @ jacobian, basis)
    return covariance[: 12 * count, : 12 * count]


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    count = len(blocks)
    matrix = np.zeros((count, 12, count, 12))
    for index, block in enumerate(blocks):
        matrix[index, :, index] = block.reshape(12, 12)
    return matrix.reshape(12 * count, 12 * count)


def _kept(gradient: FloatArray, free: np.ndarray) -> FloatArray:
    """Return a basis of the free directions along which a constraint's gradient vanishes."""
    _, _, right = np.linalg.svd(np.where(free, gradient, 0.0)[None, free])
    basis = np.zeros((len(free), int(free.sum()) - 1))
    basis[free] = right[1:].T
    return basis


def _invert(information: FloatArray, basis: FloatArray) -> FloatArray:
    """Return basis (basisᵀ I basis)⁻¹ basisᵀ, with an infinite variance of what the information leaves open."""
    inside = basis.T @ information @ basis
    scale = 1 / np.sqrt(np.maximum(np.diag(inside), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(inside * np.outer(scale, scale))
    seen = values > 1e-13 * values[-1]
    directions = basis @ (scale[:, None] * vectors)
    covariance: FloatArray = (directions[:, seen] / values[seen]) @ directions[:, seen].T
    # A parameter is open when an unseen direction moves it by a part of its error with all others known.
    alone = np.linalg.norm(basis * scale, axis=1)
    open_ = np.linalg.norm(directions[:, ~seen], axis=1) > 1e-2 * np.maximum(alone, np.finfo(float).tiny)
    covariance[np.diag_indices_from(covariance)] = np.where(open_, np.inf, np.diag(covariance))
    return covariance
