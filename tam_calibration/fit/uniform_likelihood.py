"""The likelihood in a uniform field from a source of samples: one pass over it for each linearisation."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.fit.channels import Channels
from tam_calibration.fit.gram import gram
from tam_calibration.fit.likelihood import UNIFORM, Linearization, common_mode, linearization, whitened
from tam_calibration.fit.scale import Normalized
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class UniformLikelihood:
    """As ``Likelihood``, for samples that count alike and have errors of their own.

    Parameters
    ----------
    data : Normalized
        Readings and intensities.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes.
    scalar_noise : float
        Standard deviation of the intensity's error.
    """

    data: Normalized
    vector_noise: FloatArray
    scalar_noise: float

    def linearize(self, matrix: FloatArray, bias: FloatArray) -> Linearization:
        """Return the normal equations at matrices D Λ (K, 3, 3) and biases (K, 3)."""
        channels = Channels.at(matrix, bias, UNIFORM, self.vector_noise, None)
        size = channels.response[0].size + 1
        common, count = np.zeros((size, size)), 0
        for points, intensity in self.data.blocks():
            there = common_mode(channels, points[:-1], intensity, self.scalar_noise)
            columns = whitened(there, points[:0])
            common += gram(columns)
            count += columns.shape[1]
        return linearization(channels, self.data.moments, common, count)
