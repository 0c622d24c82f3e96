"""The likelihood of the sensors' errors with each sample's field eliminated, linearised.

What is left of a sample's 3K + 1 readings without its three field components is white: 3K - 3 differential channels
between the sensors, and one common-mode channel, the scalar minus the length of the field that the sensors agree on.
The differential channels are bilinear in data and parameters, so that the second moments of the readings, taken once,
serve every point; the common mode takes one pass over the data, in pieces that fit the processor's cache.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import inv, norm
from numpy.typing import NDArray

from tam_calibration.units import FloatArray

BoolArray = NDArray[np.bool_]

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

    @property
    def channel_count(self) -> FloatArray:
        """(N,) number of whitened channels of each sample: 3K - 3, and one more with a reference."""
        count: FloatArray = 3.0 * self.points.shape[1] - 3 + np.isfinite(self.intensity)
        return count

    def linearize(self, matrix: FloatArray, bias: FloatArray, weights: FloatArray | None = None) -> Linearization:
        """Return the normal equations at matrices D Λ (K, 3, 3) and biases (K, 3).

        Each sample counts by its weight (N,), or as one.
        """
        channels = _Channels.at(matrix, self.vector_noise)
        moments = self._moments if weights is None else _second_moments(self._flat, weights)
        # From [y, 1] to [y - o], and on to [b, 1].
        unbias = np.column_stack([np.eye(channels.complement.shape[0]), -bias.ravel()])
        extend = np.vstack([channels.unmix @ unbias, np.eye(1, unbias.shape[1], unbias.shape[1] - 1)])
        information = np.einsum("ab,cd->acbd", channels.complement, extend @ moments @ extend.T)
        gradient = channels.complement @ (unbias @ moments @ extend.T)
        differential = float(np.sum(channels.complement * (unbias @ moments @ unbias.T)))

        gram, slope, common_mode = np.zeros((12, 12)), np.zeros(12), 0.0
        for part in self._pieces():
            field, length, misfit, precision, known = self._common_mode(part, channels, bias)
            if weights is not None:
                precision = precision * weights[part][known]
            extended = np.column_stack([field, np.ones(len(field))])
            features = ((field / length[:, None])[:, :, None] * extended[:, None, :]).reshape(-1, 12)
            weighted = features * precision[:, None]
            gram += weighted.T @ features
            slope += weighted.T @ misfit
            common_mode += float(precision @ misfit**2)
        unmix = channels.unmix
        information += np.einsum("ia,idje,jb->adbe", unmix, gram.reshape(3, 4, 3, 4), unmix, optimize=True)
        gradient += unmix.T @ slope.reshape(3, 4)
        reference_count = int(np.isfinite(self.intensity).sum())
        size = gradient.size
        return Linearization(
            information.reshape(size, size), gradient.ravel(), differential, common_mode, reference_count
        )

    def energy(self, matrix: FloatArray, bias: FloatArray) -> FloatArray:
        """Return the (N,) sums of the squares of each sample's whitened channels."""
        channels = _Channels.at(matrix, self.vector_noise)
        energy = np.empty(len(self.points))
        for part in self._pieces():
            unbiased = self._flat[part] - bias.ravel()
            energy[part] = np.maximum(np.sum((unbiased @ channels.complement) * unbiased, axis=1), 0)
            _, _, misfit, precision, known = self._common_mode(part, channels, bias)
            energy[part][known] += precision * misfit**2
        return energy

    @property
    def _flat(self) -> FloatArray:
        return self.points.reshape(len(self.points), -1)

    @cached_property
    def _moments(self) -> FloatArray:
        return _second_moments(self._flat, None)

    def _pieces(self) -> Iterator[slice]:
        for start in range(0, len(self.points), _PIECE):
            yield slice(start, start + _PIECE)

    def _common_mode(
        self, part: slice, channels: "_Channels", bias: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, BoolArray]:
        """Return field, its length, the misfit to the reference and its precision, and where there is a reference."""
        intensity = self.intensity[part]
        known = np.isfinite(intensity)
        field = (self._flat[part] @ channels.unmix.T - channels.unmix @ bias.ravel())[known]
        length = norm(field, axis=1)
        direction = field / length[:, None]
        variance = self.scalar_noise**2 + np.sum((direction @ channels.covariance) * direction, axis=1)
        return field, length, length - intensity[known], 1 / variance, known


@dataclass(frozen=True, eq=False)
class _Channels:
    """What turns unbiased readings into the field they agree on, and into the rest in which they differ.

    Parameters
    ----------
    unmix : (3, 3K) array
        To the weighted least-squares field.
    covariance : (3, 3) array
        Of that field.
    complement : (3K, 3K) array
        Quadratic form of the whitened differential channels.
    """

    unmix: FloatArray
    covariance: FloatArray
    complement: FloatArray

    @classmethod
    def at(cls, matrix: FloatArray, vector_noise: FloatArray) -> "_Channels":
        rows = matrix.reshape(-1, 3)
        weight = 1 / np.repeat(vector_noise, 3)
        basis, _ = np.linalg.qr(weight[:, None] * rows)
        covariance = inv(rows.T @ (weight[:, None] ** 2 * rows))
        unmix = covariance @ (weight[:, None] ** 2 * rows).T
        return cls(unmix, covariance, weight[:, None] * (np.eye(len(rows)) - basis @ basis.T) * weight)


def _second_moments(flat: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Return the (M + 1, M + 1) sum of the outer products of rows (N, M) followed by 1."""
    weighted = flat if weights is None else flat * weights[:, None]
    total = np.empty((flat.shape[1] + 1, flat.shape[1] + 1))
    total[:-1, :-1] = weighted.T @ flat
    total[:-1, -1] = total[-1, :-1] = weighted.sum(axis=0)
    total[-1, -1] = len(flat) if weights is None else weights.sum()
    return total
