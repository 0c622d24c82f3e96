"""The regional field of a run beside a line of current, from what each sample needs of it.

A current's field falls so slowly that no part of a run is free of it: the median of the run is far off. But of the
eight outputs of a sample a line of current takes five unknowns, and what is left depends on the regional field u, which
all samples share in the world. With the line of each sample eliminated a step δu is that of

    Σ Aᵀ (1 - J (JᵀJ)⁻¹ Jᵀ) (A δu - r) = 0,

A and J the derivatives of the whitened outputs by u and by the line, r their residuals (variable projection, Kaufman
1975). A line of dipoles leaves nothing of the two components across it: field and tensor there are as many numbers as
its place and moment.
"""

from dataclasses import replace

import numpy as np

from tam_calibration.localization.euler import locate
from tam_calibration.localization.finite_baseline import fit_outputs, is_certain, start_of, whitening_of
from tam_calibration.localization.line_fit import CURRENT_INDEX
from tam_calibration.localization.sample_by_sample import Regional, matrices_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray

_MOST_STEPS, _SETTLED = 30, 1e-3
"""Steps to the regional field, and the part of its standard errors below which one is the last."""


def regional_beside_current(
    outputs: FloatArray, array: Array, covariance: FloatArray, attitude: FloatArray, prior: Regional
) -> Regional:
    """Return the regional field with which the samples of a run are best explained, each by a line of current.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) array
        Of the outputs.
    attitude : (N, 4) array
        Exact: quaternions x, y, z, w from the array frame to the world; NaN where unknown.
    prior : Regional
        What is known of the field beforehand, with variances.

    Raises
    ------
    Refused
        When no sample can be located, or the steps do not settle.
    """
    assert prior.covariance_T2 is not None
    error = np.sqrt(np.maximum(np.diag(prior.covariance_T2), np.diag(covariance)[:3]))
    field_T, matrix = prior.field_T, matrices_of(attitude)
    for _ in range(_MOST_STEPS):
        residuals, by_field = _left(outputs, array, covariance[:8, :8], matrix, field_T)
        slopes = by_field * error
        normal = np.einsum("nij,nik->jk", slopes, slopes) + np.eye(3)
        away = np.einsum("nij,ni->j", slopes, residuals) + (prior.field_T - field_T) / error
        step = np.linalg.solve(normal, away)
        field_T = field_T + error * step
        if step @ normal @ step < _SETTLED**2:
            return replace(prior, field_T=field_T, covariance_T2=np.linalg.inv(normal) * np.outer(error, error))
    raise Refused(f"{_NO_LINE}: the steps to the regional field do not settle")


_NO_LINE = "the samples are not those of a line of current beside a uniform regional field"
_NONE_LOCATED = f"{_NO_LINE}: none can be located. Go nearer, or average longer"


def _left(
    outputs: FloatArray, array: Array, covariance: FloatArray, matrix: FloatArray, field_T: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return what lines leave of n samples (n, 8), whitened, and its derivatives (n, 8, 3) by the regional field."""
    source = outputs[:, :8].copy()
    source[:, :3] -= np.einsum("nji,j->ni", matrix, field_T)
    euler = locate(source, covariance, index=CURRENT_INDEX)
    at = np.flatnonzero(euler.is_located)
    if not len(at):
        raise Refused(_NONE_LOCATED)
    start = start_of(euler, source, CURRENT_INDEX)[at]
    fit = fit_outputs(source[at], array, covariance, start, CURRENT_INDEX)
    is_kept = fit.solution.is_found & is_certain(fit.solution.unknowns, fit.solution.covariance)
    if not is_kept.any():
        raise Refused(_NONE_LOCATED)
    by_field = whitening_of(covariance)[:, :3] @ np.swapaxes(matrix[at[is_kept]], 1, 2)
    basis = np.linalg.qr(fit.slopes[is_kept])[0]
    return fit.residuals[is_kept], by_field - basis @ (np.swapaxes(basis, 1, 2) @ by_field)
