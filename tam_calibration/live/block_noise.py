"""By how much the means of blocks of samples vary more than white noise of the stated size makes them.

At sea noise lasts that was white at the pier: a motor, waves, the heading error of a scalar. Differences of the means
of two blocks do not contain what is constant, as errors of the sensors are, and of a change or a passing source only
some differences do: their median tells the noise. Of noise that lasts longer, differences over a longer time tell more.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm
from scipy.special import chdtri

from tam_calibration.core.variance_factors import VarianceFactors
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray

_REMEMBERED = 64
"""Blocks, two minutes: a change or a source within them spoils less than half of the differences."""

_LAGS = (1, 4, 8)
"""Blocks between two that are compared: up to a quarter of a minute."""

_PAIRS = 4
"""Pairs of blocks over the blocks between them, from which they are compared: a change is in a quarter of them."""

_SURE = 5.0
"""Standard deviations of the logarithm of a mean of normal squares by which a median may exceed that of white noise."""


@dataclass(frozen=True, eq=False)
class BlockMeans:
    """Means over the samples of a block.

    Parameters
    ----------
    readings_T : (K, 3) array
        Raw readings, tesla.
    intensity_T : float
        Of the mean field of the sensors, tesla.
    beyond_T : float
        That intensity beyond the reading of the scalar, tesla.
    count, scalar_count : int
        Number of samples, and of those with a scalar reading.
    errors : SensorErrors
        By which the fields were restored.
    """

    readings_T: FloatArray
    intensity_T: float
    beyond_T: float
    count: int
    scalar_count: int
    errors: SensorErrors

    @classmethod
    def of(cls, errors: SensorErrors, readings_T: FloatArray, scalar_T: FloatArray) -> "BlockMeans":
        """Return those of samples: readings (n, K, 3) and intensities (n,), NaN where there is none."""
        known = np.isfinite(scalar_T)
        intensity_T = norm(errors.restore(readings_T).mean(axis=1), axis=1)
        beyond_T = float(np.mean((intensity_T - scalar_T)[known])) if known.any() else 0.0
        mean_T = float(intensity_T.mean())
        return cls(readings_T.mean(axis=0), mean_T, beyond_T, len(readings_T), int(known.sum()), errors)

    def at(self, errors: SensorErrors) -> FloatArray:
        """Return by how much sensors and scalar differ from the common field with other errors, tesla.

        Returns
        -------
        (3 K + 1,) array
            Of the axes of each sensor, and of the intensity.
        """
        fields_T, before_T = (each.restore(self.readings_T[None])[0] for each in (errors, self.errors))
        differences_T = np.einsum("kij,kj->ki", errors.matrix, fields_T - fields_T.mean(axis=0))
        beyond_T = self.beyond_T + norm(fields_T.mean(axis=0)) - norm(before_T.mean(axis=0))
        return np.append(differences_T, beyond_T)


def noise_of(array: KnownNoiseArray) -> FloatArray:
    """Return the noise (3 K + 1,) of ``BlockMeans.at`` for one sample, tesla; the sensors share their mean."""
    count, vector_T2 = len(array.vector_noise_T), float(np.mean(array.vector_noise_T**2))
    return np.sqrt([*[vector_T2] * (3 * count), vector_T2 / count + array.scalar_noise_T**2])


class BlockNoise:
    """Follows the noise of both channels.

    Parameters
    ----------
    array : KnownNoiseArray
        With the noise that is stated.
    """

    def __init__(self, array: KnownNoiseArray) -> None:
        self._noise_T, self._freedom = noise_of(array), 3 * len(array.vector_noise_T) - 3
        self._blocks: deque[BlockMeans] = deque(maxlen=_REMEMBERED)

    def add(self, means: BlockMeans) -> None:
        """Add a block."""
        self._blocks.append(means)

    @property
    def is_known(self) -> bool:
        """Whether it has seen blocks enough for noise that lasts."""
        return len(self._blocks) >= (_PAIRS + 1) * _LAGS[-1]

    def factors(self, errors: SensorErrors) -> VarianceFactors:
        """Return the variance of the means of blocks over that of white noise; 1 where it may be that.

        Parameters
        ----------
        errors : SensorErrors
            As they are known now: what an earlier estimate made of the blocks is no noise.
        """
        values = np.array([means.at(errors) for means in self._blocks]) / self._noise_T
        counts = np.array([(means.count, means.scalar_count) for means in self._blocks])
        known = counts[:, 1] > 0
        return VarianceFactors(
            _factor(values[:, :-1], counts[:, 0], self._freedom), _factor(values[known, -1:], counts[known, 1], 1)
        )


def _factor(values: FloatArray, counts: IntArray, freedom: int) -> float:
    """Return the variance of the means (M, C) of so many samples (M,) over that of white noise.

    What grows with the time between blocks, as the heading error of a scalar does, is the same in all of them: it does
    not become smaller in their mean.
    """
    found, ratio_of_next = 1.0, 1.0
    for lag in _LAGS if freedom else ():
        pairs = len(values) - lag
        if pairs >= _PAIRS * lag:
            energies = np.sum((values[lag:] - values[:-lag]) ** 2, axis=1) / (1 / counts[lag:] + 1 / counts[:-lag])
            ratio = float(np.median(energies) / chdtri(freedom, 0.5))
            by_chance = np.exp(_SURE * np.sqrt(2 / (freedom * pairs)))
            ratio = ratio if ratio > by_chance else 1.0
            ratio_of_next = ratio if lag == 1 else ratio_of_next
            lasting = ratio - ratio_of_next if ratio > by_chance * ratio_of_next else 0.0
            found = max(found, ratio + lasting * (len(values) - 1))
    return found
