"""The likelihood of the sensors' errors with each sample's field eliminated, linearised.

What is left of a sample's 3K + 1 readings without its three field components is white: 3K - 3 differential channels
between the sensors, and one common-mode channel, the scalar minus the length of the field that the sensors agree on.
The differential channels are bilinear in data and parameters, so that the second moments of the readings, taken once,
serve every point; the common mode takes one pass over the data, in pieces that fit the processor's cache.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.fit.channels import Channels, Turning
from tam_calibration.fit.reference import InterpolationNoise
from tam_calibration.units import FloatArray

BoolArray = NDArray[np.bool_]

UNIFORM = np.empty(0)
"""The components of the gradient of a field that has none."""

_PIECE = 8192


@dataclass(frozen=True, eq=False)
class Linearization:
    """Normal equations of the whitened channels at a point.

    The parameters are the flattened (3K, 4) rows of [D Λ | o], then P components of an ambient gradient: 5, or none.

    Parameters
    ----------
    information : (12 K + P, 12 K + P) array
        Fisher information; singular along the common rotation of the array.
    gradient : (12 K + P,) array
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
    scalar_noise : float or (N,) array
        Standard deviation of the intensity's error that is each sample's own.
    interpolation_noise : InterpolationNoise, optional
        Errors of the intensity that neighbouring samples have in common.
    turning : Turning, optional
        Attitudes and positions where the field has an ambient gradient.
    """

    points: FloatArray
    intensity: FloatArray
    vector_noise: FloatArray
    scalar_noise: float | FloatArray
    interpolation_noise: InterpolationNoise | None = None
    turning: Turning | None = None

    @property
    def channel_count(self) -> FloatArray:
        """(N,) number of whitened channels of each sample: 3K - 3, and one more with a reference."""
        count: FloatArray = 3.0 * self.points.shape[1] - 3 + np.isfinite(self.intensity)
        return count

    def linearize(
        self,
        matrix: FloatArray,
        bias: FloatArray,
        weights: FloatArray | None = None,
        ambient_gradient: FloatArray = UNIFORM,
    ) -> Linearization:
        """Return the normal equations at matrices D Λ (K, 3, 3), biases (K, 3) and components of the gradient.

        Each sample counts by its weight (N,), or as one.
        """
        channels = Channels.at(matrix, bias, ambient_gradient, self.vector_noise, self.turning)
        moments = self._moments if weights is None else _second_moments(self._flat, weights)
        information, gradient, differential = _differential(channels, moments)
        size = channels.response[0].size
        common = self._common_mode_moments(channels, weights)
        response = channels.response.reshape(-1, size)
        information += response @ common[:size, :size] @ response.T
        gradient += response @ common[:size, size]
        reference_count = int(np.isfinite(self.intensity).sum())
        return Linearization(information, gradient, differential, float(common[size, size]), reference_count)

    def energy(self, matrix: FloatArray, bias: FloatArray, ambient_gradient: FloatArray = UNIFORM) -> FloatArray:
        """Return the (N,) sums of the squares of each sample's whitened channels."""
        assert self.interpolation_noise is None, "what samples share is no sample's own"
        channels = Channels.at(matrix, bias, ambient_gradient, self.vector_noise, self.turning)
        energy = np.empty(len(self.points))
        for part in self._pieces():
            unbiased = self._flat[part] @ channels.unbiased[:, :-1].T + channels.unbiased[:, -1]
            energy[part] = np.maximum(np.sum((unbiased @ channels.complement) * unbiased, axis=1), 0)
            _, _, misfit, precision, known = self._common_mode(part, channels)
            energy[part][known] += precision * misfit**2
        return energy

    @cached_property
    def _flat(self) -> FloatArray:
        """(N, Z - 1) rows without their 1."""
        flat = self.points.reshape(len(self.points), -1)
        return flat if self.turning is None else np.column_stack([flat, self.turning.features])

    @cached_property
    def _moments(self) -> FloatArray:
        return _second_moments(self._flat, None)

    def _pieces(self) -> Iterator[slice]:
        for start in range(0, len(self.points), _PIECE):
            yield slice(start, start + _PIECE)

    def _common_mode_moments(self, channels: Channels, weights: FloatArray | None) -> FloatArray:
        """Return the whitened second moments of direction ⊗ [field, features, 1] and, last, of the misfit."""
        size = channels.response[0].size + 1
        total, kept = np.zeros((size, size)), []
        for part in self._pieces():
            field, direction, misfit, precision, known = self._common_mode(part, channels)
            if weights is not None:
                precision = precision * weights[part][known]
            features = self._flat[part, 3 * self.points.shape[1] :][known]
            extended = np.column_stack([field, features, np.ones(len(field))])
            columns = np.empty((len(field), size))
            columns[:, :-1] = (direction[:, :, None] * extended[:, None, :]).reshape(len(field), -1)
            columns[:, -1] = misfit
            weighted = columns * precision[:, None]
            total += weighted.T @ columns
            if self.interpolation_noise is not None:
                kept.append((weighted, precision))
        if self.interpolation_noise is None:
            return total
        return total - self.interpolation_noise.explained(
            *(np.concatenate(column) for column in zip(*kept, strict=True))
        )

    def _common_mode(
        self, part: slice, channels: Channels
    ) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, slice | BoolArray]:
        """Return field and direction there, the misfit to the reference and its precision, and where there is one."""
        intensity = self.intensity[part]
        finite = np.isfinite(intensity)
        known = slice(None) if finite.all() else finite
        field = (self._flat[part] @ channels.at_scalar[:, :-1].T + channels.at_scalar[:, -1])[known]
        length = norm(field, axis=1)
        direction = field / length[:, None]
        own: Any = self.scalar_noise if np.ndim(self.scalar_noise) == 0 else np.asarray(self.scalar_noise)[part][known]
        variance = own**2 + np.sum((direction @ channels.covariance) * direction, axis=1)
        return field, direction, length - intensity[known], 1 / variance, known


def _differential(channels: Channels, moments: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    """Return information, gradient and energy of the differential channels from the second moments of the rows."""
    count = len(channels.at_sensors)
    extend = channels.at_sensors.reshape(4 * count, -1)
    products = (extend @ moments @ extend.T).reshape(count, 1, 4, count, 1, 4)
    by_rows = channels.complement.reshape(count, 3, 1, count, 3, 1) * products
    unbiased = channels.unbiased @ moments
    white = channels.complement @ unbiased
    gradient = np.einsum("iaz,icz->iac", white.reshape(count, 3, -1), channels.at_sensors).ravel()
    energy = float(np.sum(channels.complement * (unbiased @ channels.unbiased.T)))
    information = by_rows.reshape(12 * count, 12 * count)
    if not channels.by_gradient.shape[1]:
        return information, gradient, energy
    by_gradient = channels.by_gradient
    whitened = np.einsum("ab,bpy,yz->apz", channels.complement, by_gradient, moments, optimize=True)
    cross = np.einsum("icz,iapz->iacp", channels.at_sensors, whitened.reshape(count, 3, *whitened.shape[1:]))
    cross = cross.reshape(12 * count, -1)
    own = np.einsum("apz,aqz->pq", whitened, by_gradient)
    downhill = np.einsum("apz,az->p", by_gradient, white)
    return np.block([[information, cross], [cross.T, own]]), np.append(gradient, downhill), energy


def _second_moments(flat: FloatArray, weights: FloatArray | None) -> FloatArray:
    """Return the (M + 1, M + 1) sum of the outer products of rows (N, M) followed by 1."""
    weighted = flat if weights is None else flat * weights[:, None]
    total = np.empty((flat.shape[1] + 1, flat.shape[1] + 1))
    total[:-1, :-1] = weighted.T @ flat
    total[:-1, -1] = total[-1, :-1] = weighted.sum(axis=0)
    total[-1, -1] = len(flat) if weights is None else weights.sum()
    return total
