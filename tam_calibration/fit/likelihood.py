"""The likelihood of the sensors' errors with each sample's field eliminated, linearised.

What is left of a sample's 3K + 1 readings without its three field components is white: 3K - 3 differential channels
between the sensors, and one common-mode channel, the scalar minus the length of the field that the sensors agree on.
The differential channels are bilinear in data and parameters, so their normal equations need moments only.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Linearization:
    """Normal equations of the whitened channels at a point.

    The parameters are the flattened (3K, 4) rows of [D Λ | o].

    Parameters
    ----------
    information : (12 K, 12 K) array
        Fisher information; singular along the common rotation of the array.
    gradient : (12 K,) array
        Downhill: ``information @ step = gradient`` is the Gauss-Newton step.
    differential, common_mode : float
        Sums of the squares of the whitened channels.
    reference_count : int
        Number of samples with a reference intensity.
    """

    information: FloatArray
    gradient: FloatArray
    differential: float
    common_mode: float
    reference_count: int


def linearize(
    points: FloatArray,
    intensity: FloatArray,
    matrix: FloatArray,
    bias: FloatArray,
    vector_noise: FloatArray,
    scalar_noise: float,
) -> Linearization:
    """Linearise the likelihood; all arguments in one unit, best of order one.

    Parameters
    ----------
    points : (N, K, 3) array
        Readings.
    intensity : (N,) array
        Reference intensity; NaN where there is none.
    matrix : (K, 3, 3) array
        D Λ of each sensor.
    bias : (K, 3) array
        Reading in zero field.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes.
    scalar_noise : float
        Standard deviation of the intensity.
    """
    rows = matrix.reshape(-1, 3)
    weight = 1 / np.repeat(vector_noise, 3)
    basis, _ = np.linalg.qr(weight[:, None] * rows)
    covariance = inv(rows.T @ (weight[:, None] ** 2 * rows))
    unmix = covariance @ (weight[:, None] ** 2 * rows).T
    complement = weight[:, None] * (np.eye(len(rows)) - basis @ basis.T) * weight
    unbiased = (points - bias).reshape(len(points), -1)
    field = unbiased @ unmix.T
    extended = np.column_stack([field, np.ones(len(field))])
    information = np.einsum("ab,cd->acbd", complement, extended.T @ extended)
    gradient = complement @ (unbiased.T @ extended)
    differential = float(np.sum(complement * (unbiased.T @ unbiased)))

    known = np.isfinite(intensity)
    if not known.all():
        field, extended, intensity = field[known], extended[known], intensity[known]
    length = norm(field, axis=1)
    direction = field / length[:, None]
    misfit = length - intensity
    precision = 1 / (scalar_noise**2 + np.sum((direction @ covariance) * direction, axis=1))
    features = (direction[:, :, None] * extended[:, None, :]).reshape(-1, 12)
    weighted = features * precision[:, None]
    gram = (weighted.T @ features).reshape(3, 4, 3, 4)
    information += np.einsum("ia,idje,jb->adbe", unmix, gram, unmix, optimize=True)
    gradient += unmix.T @ (weighted.T @ misfit).reshape(3, 4)
    size = 4 * len(rows)
    return Linearization(
        information.reshape(size, size), gradient.ravel(), differential, float(precision @ misfit**2), len(misfit)
    )
