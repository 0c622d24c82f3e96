"""What is left of corrected readings in a uniform field of known intensity, and what noise alone would leave."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.array import TENSOR_OUTPUTS, Array
from tam_calibration.errors import SensorErrors
from tam_calibration.recording import Recording, pieces
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class ResidualSeries:
    """Residuals of every sample in a uniform field of known intensity.

    Parameters
    ----------
    sensor_intensity_T : (N, K) array
        |b_i| - s for each sensor, tesla; NaN where there is no reference.
    center_intensity_T : (N,) array
        The same for the centre vector, tesla.
    tensor_T_per_m : (N, 5) array
        Components xx, xy, xz, yy, yz, T/m; NaN where the geometry has no gradient.
    """

    sensor_intensity_T: FloatArray
    center_intensity_T: FloatArray
    tensor_T_per_m: FloatArray


@dataclass(frozen=True, eq=False)
class Residuals:
    """Root mean square residuals of corrected readings in a uniform field of known intensity.

    Parameters
    ----------
    sensor_intensity_T : (K,) array
        RMS of |b_i| - s for each sensor (Wu 2025 eqs. 14, 15), tesla.
    center_intensity_T : float
        The same for the centre vector, tesla.
    tensor_T_per_m : (5,) array
        RMS of the components xx, xy, xz, yy, yz, T/m; NaN where the geometry has no gradient.
    """

    sensor_intensity_T: FloatArray
    center_intensity_T: float
    tensor_T_per_m: FloatArray

    @property
    def tensor_rmse_T_per_m(self) -> float:
        """Root of the summed squares of the five components, e_T of Wu 2025 eqs. 16, 17."""
        return float(norm(self.tensor_T_per_m))


def residual_series(
    errors: SensorErrors, array: Array, recording: Recording, intensity_T: float, part: slice = slice(None)
) -> ResidualSeries:
    """Return the residuals of samples of a recording in a uniform field, corrected with given errors.

    ``intensity_T`` stands in where the recording has no scalar channel; ``part`` selects samples, by default all.
    """
    corrected = errors.restore(recording.readings_T[part])
    scalar = np.full(len(corrected), intensity_T) if recording.scalar_T is None else recording.scalar_T[part]
    outputs = corrected.reshape(len(corrected), -1) @ array.operator.T
    return ResidualSeries(
        norm(corrected, axis=2) - scalar[:, None],
        norm(outputs[:, :3], axis=1) - scalar,
        outputs[:, TENSOR_OUTPUTS],
    )


def measure_residuals(errors: SensorErrors, array: Array, recording: Recording, intensity_T: float) -> Residuals:
    """Return the root mean square residuals of a recording, as in ``residual_series``."""
    sensors, center, tensor, known_count = np.zeros(errors.sensor_count), 0.0, np.zeros(len(TENSOR_OUTPUTS)), 0
    for part in pieces(recording.sample_count):
        series = residual_series(errors, array, recording, intensity_T, part)
        known = np.isfinite(series.center_intensity_T)
        sensors += np.sum(series.sensor_intensity_T[known] ** 2, axis=0)
        center += float(np.sum(series.center_intensity_T[known] ** 2))
        tensor += np.sum(series.tensor_T_per_m**2, axis=0)
        known_count += int(known.sum())
    return Residuals(
        np.sqrt(sensors / known_count),
        float(np.sqrt(center / known_count)),
        np.sqrt(tensor / recording.sample_count),
    )


def noise_floor(errors: SensorErrors, array: Array, scalar_noise_T: float) -> Residuals:
    """Return the residuals that sensor noise alone leaves, whatever the calibration.

    The noise of an intensity is the mean over all directions of the noise along the field.
    """
    assert array.vector_noise_T is not None
    unmix = inv(errors.matrix)
    sensor_variance = array.vector_noise_T**2 * (unmix**2).sum(axis=(1, 2)) / 3
    operator = np.einsum("rki,kij->rkj", array.operator.reshape(9, -1, 3), unmix).reshape(9, -1)
    output_variance = operator**2 @ np.repeat(array.vector_noise_T**2, 3)
    return Residuals(
        np.sqrt(sensor_variance + scalar_noise_T**2),
        float(np.sqrt(output_variance[:3].mean() + scalar_noise_T**2)),
        np.sqrt(output_variance[list(TENSOR_OUTPUTS)]),
    )
