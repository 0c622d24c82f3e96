"""The likelihood of the sensors' errors with each sample's field eliminated, linearised.

What is left of a sample's 3K + 1 readings without its three field components is white: 3K - 3 differential channels
between the sensors, and one common-mode channel, the scalar minus the length of the field that the sensors agree on.
The differential channels are bilinear in data and parameters, so that the second moments of the readings, taken once,
serve every point; the common mode takes one pass over the data, in pieces that fit the processor's cache.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.units import FloatArray

_PIECE = 8192


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


@dataclass(frozen=True, eq=False)
class Likelihood:
    """Readings, reference and noise; all in one unit, best of order one.

    Parameters
    ----------
    points : (N, K, 3) array
        Readings.
    intensity : (N,) array
        Reference intensity; NaN where there is none.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes.
    scalar_noise : float
        Standard deviation of the intensity.
    """

    points: FloatArray
    intensity: FloatArray
    vector_noise: FloatArray
    scalar_noise: float

    @cached_property
    def _moments(self) -> FloatArray:
        """(3K + 1, 3K + 1) sum of the outer products of the readings followed by 1."""
        flat = self.points.reshape(len(self.points), -1)
        total = np.zeros((flat.shape[1] + 1, flat.shape[1] + 1))
        total[:-1, :-1] = flat.T @ flat
        total[:-1, -1] = total[-1, :-1] = flat.sum(axis=0)
        total[-1, -1] = len(flat)
        return total

    def linearize(self, matrix: FloatArray, bias: FloatArray) -> Linearization:
        """Return the normal equations at matrices D Λ (K, 3, 3) and biases (K, 3)."""
        rows = matrix.reshape(-1, 3)
        weight = 1 / np.repeat(self.vector_noise, 3)
        basis, _ = np.linalg.qr(weight[:, None] * rows)
        covariance = inv(rows.T @ (weight[:, None] ** 2 * rows))
        unmix = covariance @ (weight[:, None] ** 2 * rows).T
        complement = weight[:, None] * (np.eye(len(rows)) - basis @ basis.T) * weight

        # From [y, 1] to [y - o], and on to [b, 1].
        unbias = np.column_stack([np.eye(len(rows)), -bias.ravel()])
        extend = np.vstack([unmix @ unbias, np.eye(1, len(rows) + 1, len(rows))])
        information = np.einsum("ab,cd->acbd", complement, extend @ self._moments @ extend.T)
        gradient = complement @ (unbias @ self._moments @ extend.T)
        differential = float(np.sum(complement * (unbias @ self._moments @ unbias.T)))

        gram, slope, common_mode, count = self._common_mode(unmix, unmix @ bias.ravel(), covariance)
        information += np.einsum("ia,idje,jb->adbe", unmix, gram.reshape(3, 4, 3, 4), unmix, optimize=True)
        gradient += unmix.T @ slope.reshape(3, 4)
        size = 4 * len(rows)
        return Linearization(information.reshape(size, size), gradient.ravel(), differential, common_mode, count)

    def _common_mode(
        self, unmix: FloatArray, offset: FloatArray, covariance: FloatArray
    ) -> tuple[FloatArray, FloatArray, float, int]:
        """Return the (12, 12) Gram matrix of the derivatives u ⊗ [b, 1], their product with the misfit, its energy."""
        gram, slope, energy, count = np.zeros((12, 12)), np.zeros(12), 0.0, 0
        flat = self.points.reshape(len(self.points), -1)
        for start in range(0, len(flat), _PIECE):
            intensity = self.intensity[start : start + _PIECE]
            known = np.isfinite(intensity)
            field = (flat[start : start + _PIECE] @ unmix.T - offset)[known]
            length = norm(field, axis=1)
            direction = field / length[:, None]
            misfit = length - intensity[known]
            precision = 1 / (self.scalar_noise**2 + np.sum((direction @ covariance) * direction, axis=1))
            extended = np.column_stack([field, np.ones(len(field))])
            features = (direction[:, :, None] * extended[:, None, :]).reshape(-1, 12)
            weighted = features * precision[:, None]
            gram += weighted.T @ features
            slope += weighted.T @ misfit
            energy += float(precision @ misfit**2)
            count += len(misfit)
        return gram, slope, energy, count
