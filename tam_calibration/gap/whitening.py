"""How the rows of a sample become white channels: the same for all samples of an array at given errors."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv

from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Whitening:
    """The field that the sensors agree on, and the directions between them in which it does not show.

    Parameters
    ----------
    unmix : (3, 3K) array
        Weighted least-squares estimate of the field from the rows without bias.
    covariance : (3, 3) array
        Of that estimate, T².
    directions : (3K, C) array
        How a shift of each row moves the differential channels, 1/T; C is 3K - 3, or 3K where the field is known.
    scalar_variance : float
        Of the scalar magnetometer's noise, T².
    """

    unmix: FloatArray
    covariance: FloatArray
    directions: FloatArray
    scalar_variance: float

    @classmethod
    def of(cls, array: Array, errors: SensorErrors, row_variance: FloatArray | None = None) -> "Whitening":
        """Return the whitening of an array with noise, and with white noise (3K + 1,) beyond it, T²."""
        matrix = errors.matrix.reshape(-1, 3)
        weight = _weight(array, row_variance)
        covariance = inv(matrix.T @ (weight[:, None] ** 2 * matrix))
        basis, _ = np.linalg.qr(weight[:, None] * matrix, mode="complete")
        return cls(
            covariance @ (weight[:, None] ** 2 * matrix).T,
            covariance,
            weight[:, None] * basis[:, 3:],
            float((array.scalar_noise_T or 0.0) ** 2 + (0.0 if row_variance is None else row_variance[-1])),
        )

    @classmethod
    def of_known_field(cls, array: Array, row_variance: FloatArray | None = None) -> "Whitening":
        """Return the whitening of rows that are compared with a field known otherwise: each is a channel of its own."""
        weight = _weight(array, row_variance)
        rows = len(weight)
        return cls(np.zeros((3, rows)), np.zeros((3, 3)), np.diag(weight), 0.0)

    @property
    def turn(self) -> FloatArray:
        """(4, 3K + 1) by which direction and 1 become how a shift of each row moves the scalar minus the length."""
        turn = np.zeros((4, self.unmix.shape[1] + 1))
        turn[:3, :-1], turn[3, -1] = -self.unmix, 1
        return turn

    def common_variance(self, direction: FloatArray) -> FloatArray:
        """Return the variance (N,) of the scalar minus the length of a field in a direction (N, 3), T²."""
        variance: FloatArray = self.scalar_variance + np.einsum("ni,ij,nj->n", direction, self.covariance, direction)
        return variance


def _weight(array: Array, row_variance: FloatArray | None) -> FloatArray:
    """Return the inverse standard deviation (3K,) of the rows of the sensors, 1/T."""
    assert array.vector_noise_T is not None
    variance = np.repeat(array.vector_noise_T**2, 3)
    weight: FloatArray = 1 / np.sqrt(variance if row_variance is None else variance + row_variance[:-1])
    return weight
