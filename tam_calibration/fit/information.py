"""The Fisher information of samples, taken apart, and what follows from it: Gauss-Newton steps, Cramér–Rao bound.

A sample's 3K + 1 readings without its three field components are 3K - 3 differential channels, which are affine in the
field, and one common mode, the residual of the intensity. The information of all samples is therefore one 9 × 9 matrix,
by the elements of an ellipsoid, and one 4 × 4 matrix, by those of an affine map, whatever the number of sensors; a
sample adds an outer product to each, so that the worth of one more attitude costs next to nothing.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.core.least_squares import Elimination, scaled
from tam_calibration.fit.coverage import ellipsoid_rows
from tam_calibration.fit.ellipsoid import (
    COLUMNS,
    NO_ELLIPSOID,
    ROWS,
    determined,
    free_scale_gradient,
    without_scale,
)
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

Place = TypeVar("Place")
Kept = TypeVar("Kept")

NOT_ONE = "the readings do not fit one calibration, look for a change of field or sensor during the recording"


def descend(
    normal_at: Callable[[Place], tuple[FloatArray, FloatArray, Kept]],
    moved: Callable[[Place, FloatArray], Place],
    place: Place,
    robust: bool = False,
) -> tuple[Place, Kept]:
    """Return the place where Gauss-Newton steps settle, and what was kept a last step before.

    Parameters
    ----------
    normal_at : callable
        From a place to the information (M, M) of what is free there, the downhill gradient (M,), and what to keep.
    moved : callable
        From a place and a step (M,) to the next place.
    place : Place
        Where to begin.
    robust : bool
        Whether the weights of the samples change from step to step.

    Raises
    ------
    InputError
        When the information is singular.
    Refused
        When the iteration does not settle.
    """
    before = np.inf
    for _ in range(100):
        information, gradient, kept = normal_at(place)
        step = newton_step(information, gradient)
        # Twice the fall of the likelihood that the step promises; below one it is part of a standard error.
        decrement = float(step @ gradient)
        # Newton's steps fall quadratically until rounding stops them, those with new weights by a constant factor.
        is_rounding = not robust and decrement < 1e-2 and decrement > before / 4
        place, before = moved(place, step), decrement
        if is_rounding or decrement < (1e-5 if robust else 1e-6):
            return place, kept
    raise Refused(f"the fit did not settle in 100 steps: {NOT_ONE}")


@determined()
def newton_step(information: FloatArray, gradient: FloatArray) -> FloatArray:
    """Return the step (M,) to the maximum of a parabola, with its information (M, M) and downhill gradient (M,).

    Raises
    ------
    InputError
        When the information is singular.
    """
    unit, scale = scaled(information)
    if not (np.diag(information) > 0).all():
        raise InputError(NO_ELLIPSOID)
    return np.asarray(np.linalg.solve(unit, gradient / scale) / scale)


def bound(field_T: FloatArray, errors: SensorErrors, array: KnownNoiseArray, has_scalar: bool) -> FloatArray:
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
    model = InformationModel(errors, array, has_scalar, float(norm(field_T, axis=1).mean()))
    return model.covariance(information_of(model.rows(field_T)))


def rows_by_unknowns(errors: SensorErrors, unit_T: float, free_intensity_T: float | None) -> FloatArray:
    """Return the derivative of the rows [D Λ | o] of a fit by the errors of the sensors and the intensity.

    Parameters
    ----------
    errors : SensorErrors
        Where it is taken.
    unit_T : float
        Unit of field of the rows, tesla.
    free_intensity_T : float, optional
        The constant intensity, where no scalar reference tells it.

    Returns
    -------
    (12 K, 12 K or 12 K + 1) array
        The last column by the intensity over its unit, where it is free.
    """
    count = errors.sensor_count
    # Without a reference the rows of D Λ enter times the intensity F: d(F D Λ) = F d(D Λ) + D Λ dF.
    factor = 1.0 if free_intensity_T is None else free_intensity_T / unit_T
    blocks = errors.jacobian() * np.array([factor, factor, factor, 1 / unit_T])[:, None]
    by_errors = _block_diagonal(blocks).reshape(12 * count, 12 * count)
    if free_intensity_T is None:
        return by_errors
    by_intensity = np.concatenate([errors.matrix, np.zeros((count, 3, 1))], axis=2).reshape(-1, 1)
    return np.hstack([by_errors, by_intensity])


def free_basis(errors: SensorErrors, free: np.ndarray, holds_scale: bool) -> FloatArray:
    """Return the directions, as columns, of those unknowns (P,) that are free, the errors of the sensors first.

    Where the scale is held, the mean determinant does not change along them.
    """
    basis: FloatArray = np.eye(len(free))[:, free]
    if not holds_scale:
        return basis
    gradient = np.pad(free_scale_gradient(errors), (0, len(free) - 12 * errors.sensor_count))
    _, _, right = np.linalg.svd(gradient[None, free])
    return np.asarray(basis @ right[1:].T)


def inverted(information: FloatArray, basis: FloatArray) -> FloatArray:
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


def information_of(rows: FloatArray) -> FloatArray:
    """Return the (13, 13) Fisher information of samples, which adds up, from what each is sensitive to.

    Parameters
    ----------
    rows : (N, 13) array
        As of ``InformationModel.rows``.

    Returns
    -------
    (13, 13) array
        Of the common mode by the nine elements of an ellipsoid, and of each differential channel by the four elements
        of an affine map.
    """
    information: FloatArray = rows.T @ rows
    information[:9, 9:] = information[9:, :9] = 0
    return information


@dataclass(frozen=True, eq=False)
class InformationModel:
    """How information and the variances of the parameters follow from fields, linearised at given errors.

    Parameters
    ----------
    errors : SensorErrors
        Where it is linearised; the misalignment of sensor 1 counts as known.
    array : Array
        With every noise stated.
    has_scalar : bool
        Whether a scalar reference gives the scale; otherwise the intensity is an unknown constant and the mean
        determinant is fixed.
    intensity_T : float
        Of the field, tesla.
    """

    errors: SensorErrors
    array: KnownNoiseArray
    has_scalar: bool
    intensity_T: float

    def rows(self, field_T: FloatArray) -> FloatArray:
        """Return what samples at fields (N, 3) in the array frame, tesla, are sensitive to, in units of their noise.

        Returns
        -------
        (N, 13) array
            The common mode by the elements of an ellipsoid, and each differential channel by field and 1.
        """
        length = norm(field_T, axis=1, keepdims=True)
        direction = field_T / length
        scalar_noise = self.array.scalar_noise_T / self.intensity_T if self.has_scalar else 0.0
        variance = scalar_noise**2 + self._elimination.variance_along(direction.T)[:, None]
        ellipsoid = ellipsoid_rows(direction) / np.sqrt(variance)
        ellipsoid[:, :6] *= length / self.intensity_T
        return np.hstack([ellipsoid, field_T / self.intensity_T, np.ones_like(length)])

    def variances(self, information: FloatArray) -> FloatArray:
        """Return the (12 K,) variances of the parameters, SI; infinite where undetermined."""
        return np.diag(self.covariance(information))

    def covariance(self, information: FloatArray) -> FloatArray:
        """Return the (12 K, 12 K) covariance of the parameters, SI; infinite on the diagonal where undetermined."""
        covariance, is_open = np.zeros(()), np.array(False)
        for loadings, own in zip(self.loadings, (information[:9, :9], information[9:, 9:]), strict=True):
            values, vectors = np.linalg.eigh(own)
            seen = values > 1e-13 * values[-1]
            along = (loadings @ vectors).reshape(len(loadings), -1, len(values))
            known = (along[..., seen] / np.sqrt(values[seen])).reshape(len(loadings), -1)
            covariance = covariance + known @ known.T
            is_open = is_open | (norm(along[..., ~seen], axis=(1, 2)) > 1e-2 * norm(along, axis=(1, 2)))
        covariance[is_open, is_open] = np.inf
        return covariance

    def variances_with(self, information: FloatArray, rows: FloatArray) -> FloatArray:
        """Return the variances of the parameters when one of N samples is added to what is known.

        Parameters
        ----------
        information : (13, 13) array
            Of what is known; not singular.
        rows : (N, 13) array
            Of the N samples, of which each is added alone.

        Returns
        -------
        (N, 12 K) array
            Variances in the order of ``SensorErrors.to_vector`` flattened, SI.
        """
        ellipsoid, affine = self.loadings
        square = np.einsum("pki,pkj->pij", affine, affine).reshape(len(affine), 16)
        inverse, inverse_affine = inv(information[:9, :9]), inv(information[9:, 9:])
        # Sherman and Morrison's formula for the inverse of a matrix to which an outer product is added.
        gain, gain_affine = rows[:, :9] @ inverse, rows[:, 9:] @ inverse_affine
        rest = 1 + np.sum(gain * rows[:, :9], axis=1, keepdims=True)
        rest_affine = 1 + np.sum(gain_affine * rows[:, 9:], axis=1, keepdims=True)
        variance = np.sum((ellipsoid @ inverse) * ellipsoid, axis=1) + square @ inverse_affine.ravel()
        outer = (gain_affine[:, :, None] * gain_affine[:, None, :]).reshape(-1, 16)
        return np.asarray(variance - (gain @ ellipsoid.T) ** 2 / rest - outer @ square.T / rest_affine)

    @cached_property
    def noise_units(self) -> FloatArray:
        """(12 K,) factors that turn a bias, and a scale factor or angle times the field, into units of the noise."""
        relative = np.repeat([self.intensity_T, self.intensity_T, 1.0, self.intensity_T], 3)
        return np.outer(1 / self.array.vector_noise_T, relative).ravel()

    @cached_property
    def loadings(self) -> tuple[FloatArray, FloatArray]:
        """(12 K, 9) and (12 K, 3 K - 3, 4) parameters by the elements of the ellipsoid and of each affine map."""
        count = self.errors.sensor_count
        free = np.ones(12 * count, dtype=bool)
        free[9:12] = False
        in_unit = np.tile(np.repeat([1.0, 1.0, self.intensity_T, 1.0], 3), count)
        jacobian = _block_diagonal(self.errors.jacobian()) * in_unit
        jacobian[:, 3] /= self.intensity_T
        jacobian = jacobian[..., free]
        common = np.tensordot(self._elimination.unmixing, jacobian, 1)
        symmetric = (common[ROWS, COLUMNS] + common[COLUMNS, ROWS]) / 2
        affine = np.tensordot(self._elimination.directions.T, jacobian, 1).reshape(12 * count - 12, 12 * count - 3)
        loadings = np.zeros((12 * count, 12 * count - 3))
        loadings[free] = inv(np.concatenate([symmetric, common[:, 3], affine]))
        loadings = in_unit[:, None] * (loadings if self.has_scalar else without_scale(self.errors) @ loadings)
        return loadings[:, :9], loadings[:, 9:].reshape(12 * count, -1, 4)

    @cached_property
    def _elimination(self) -> Elimination:
        """Of the field in units of the intensity."""
        return Elimination.of_sensors(self.errors, self.array.vector_noise_T / self.intensity_T)


def _block_diagonal(blocks: FloatArray) -> FloatArray:
    """Return the (3 K, 4, 12 K) derivatives of all sensors from those of each, (K, 3, 4, 12)."""
    count = len(blocks)
    return np.asarray(np.einsum("kl,kxyp->kxylp", np.eye(count), blocks).reshape(3 * count, 4, 12 * count))
