"""By how much the means of blocks of samples vary more than white noise of the stated size makes them.

At sea noise lasts that was white at the pier: a motor, waves, the heading error of a scalar. Differences of the means
of two blocks do not contain what is constant, as errors of the sensors are, and of a change or a passing source only
some differences do: their median tells the noise. Of noise that lasts longer, differences over a longer time tell more.
"""

from collections import deque

import numpy as np
from scipy.special import chdtri

from tam_calibration.core.variance_factors import VarianceFactors
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_REMEMBERED = 64
"""Blocks, two minutes: a change or a source within them spoils less than half of the differences."""

_LAGS = (1, 4, 16)
"""Blocks between two that are compared: up to half a minute, within which a change is looked for."""

_FEW = 8
"""Differences below which their median is taken as it is."""

_SURE = 5.0
"""Standard deviations of a median, as of a mean of normal values, by which it may exceed that of white noise."""


def mean_deviations(errors: SensorErrors, array: KnownNoiseArray, readings_T: FloatArray) -> FloatArray:
    """Return by how much sensors differ from their common field (N, 3 K), in units of their noise.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors.
    array : KnownNoiseArray
        Their noise.
    readings_T : (N, K, 3) array
        Tesla.
    """
    weight = 1 / array.vector_noise_T**2
    fields_T = errors.restore(readings_T)
    common_T = np.einsum("k,nki->ni", weight / weight.sum(), fields_T)
    differences_T = np.einsum("kij,nkj->nki", errors.matrix, fields_T - common_T[:, None])
    return np.asarray(differences_T / array.vector_noise_T[:, None]).reshape(len(readings_T), -1)


class BlockNoise:
    """Follows the noise of both channels.

    Parameters
    ----------
    array : KnownNoiseArray
        With the noise that is stated.
    """

    def __init__(self, array: KnownNoiseArray) -> None:
        self._array = array
        self._differential: deque[tuple[FloatArray, int]] = deque(maxlen=_REMEMBERED)
        self._common_mode: deque[tuple[FloatArray, int]] = deque(maxlen=_REMEMBERED)

    def add(self, errors: SensorErrors, readings_T: FloatArray, scalar_T: FloatArray) -> None:
        """Add a block.

        Parameters
        ----------
        errors : SensorErrors
            Of the K sensors, as they are known.
        readings_T : (n, K, 3) array
            Tesla.
        scalar_T : (n,) array
            Tesla; NaN where there is none.
        """
        (deviations,) = mean_deviations(errors, self._array, readings_T.mean(axis=0, keepdims=True))
        self._differential.append((deviations, len(readings_T)))
        known = np.isfinite(scalar_T)
        if known.any():
            intensity_T = np.linalg.norm(errors.restore(readings_T[known]).mean(axis=1), axis=1)
            vector_T2, scalar_T2 = np.mean(self._array.vector_noise_T**2), self._array.scalar_noise_T**2
            residual = np.mean(intensity_T - scalar_T[known]) / np.sqrt(vector_T2 / errors.sensor_count + scalar_T2)
            self._common_mode.append((np.array([residual]), int(known.sum())))

    @property
    def factors(self) -> VarianceFactors:
        """Variance of the means of blocks over that of white noise; 1 where it may be that."""
        count = len(self._array.vector_noise_T)
        return VarianceFactors(_factor(self._differential, 3 * count - 3), _factor(self._common_mode, 1))


def _factor(blocks: deque[tuple[FloatArray, int]], freedom: int) -> float:
    if freedom == 0:
        return 1.0
    means, counts = np.array([mean for mean, _ in blocks]), np.array([count for _, count in blocks])
    found = 1.0
    for lag in _LAGS:
        pairs = len(blocks) - lag
        if pairs > 0:
            energies = np.sum((means[lag:] - means[:-lag]) ** 2, axis=1) / (1 / counts[lag:] + 1 / counts[:-lag])
            ratio = float(np.median(energies) / chdtri(freedom, 0.5))
            by_chance = 1 + _SURE * np.sqrt(2 / (freedom * pairs)) if pairs >= _FEW else 1.0
            found = max(found, ratio if ratio > by_chance else 1.0)
    return found
