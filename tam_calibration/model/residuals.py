"""Residuals of corrected readings in a uniform field of known intensity, and those of noise alone."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.array import TENSOR_OUTPUTS, Array, KnownNoiseArray
from tam_calibration.model.recording import Block, Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


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

    Examples
    --------
    >>> from tam_calibration import calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> series = calibrate(made.recording, made.scenario.array).residuals(made.recording)
    >>> series.sensor_intensity_T.shape, series.center_intensity_T.shape, series.tensor_T_per_m.shape
    ((360, 4), (360,), (360, 5))
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
    def sensors_rms_T(self) -> float:
        """RMS of |b_i| - s over all sensors, tesla."""
        return float(np.sqrt(np.mean(self.sensor_intensity_T**2)))

    @property
    def tensor_rmse_T_per_m(self) -> float:
        """Root of the summed squares of the five components, e_T of Wu 2025 eqs. 16, 17."""
        return float(norm(self.tensor_T_per_m))


def residual_series(errors: SensorErrors, array: Array, recording: Recording, intensity_T: float) -> ResidualSeries:
    """Return the residuals of the samples of a recording in a uniform field, corrected with given errors.

    Parameters
    ----------
    errors : SensorErrors
        By which the readings are corrected.
    array : Array
        Geometry of the K sensors.
    recording : Recording
        Raw readings.
    intensity_T : float
        Intensity of the field where the recording has no scalar channel, tesla.
    """
    intensity, tensor = ResidualSums(errors, array, intensity_T).of_samples(recording)
    return ResidualSeries(intensity[:-1].T, intensity[-1], tensor.T)


class ResidualSums:
    """The sums of the squared residuals of corrected readings, block by block, as in ``residual_series``.

    Parameters
    ----------
    errors : SensorErrors
        What the readings are corrected with.
    array : Array
        Geometry.
    intensity_T : float
        Stands in where there is no scalar channel.
    """

    def __init__(self, errors: SensorErrors, array: Array, intensity_T: float) -> None:
        self._intensity_T, self._sensors = intensity_T, errors.sensor_count
        unmix = _block_diagonal(errors.inverse)
        self._map = np.concatenate([unmix, array.operator[[0, 1, 2, *TENSOR_OUTPUTS]] @ unmix])
        self._offset = -self._map @ errors.bias_T.reshape(-1, 1)
        self._intensity, self._known = np.zeros(self._sensors + 1), 0
        self._tensor, self._all = np.zeros(len(TENSOR_OUTPUTS)), 0

    def of_samples(self, block: Block | Recording) -> tuple[FloatArray, FloatArray]:
        """Return each sample's residuals: of intensities (K + 1, n), NaN without a reference, and the tensor (5, n)."""
        outputs = self._map @ block.readings_T.reshape(len(block.readings_T), -1).T
        outputs += self._offset
        vectors, tensor = np.split(outputs, [3 * self._sensors + 3])
        residuals = np.sqrt((vectors**2).reshape(self._sensors + 1, 3, -1).sum(axis=1))
        residuals -= self._intensity_T if block.scalar_T is None else block.scalar_T
        return residuals, tensor

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        residuals, tensor = self.of_samples(block)
        known = np.isfinite(residuals[-1])
        if not known.all():
            residuals = residuals[:, known]
        self._intensity += np.einsum("kn,kn->k", residuals, residuals)
        self._known += residuals.shape[1]
        self._tensor += np.einsum("cn,cn->c", tensor, tensor)
        self._all += tensor.shape[1]

    def result(self) -> Residuals:
        """Return the root mean squares of what was added."""
        intensity = np.sqrt(self._intensity / self._known)
        return Residuals(intensity[:-1], float(intensity[-1]), np.sqrt(self._tensor / self._all))


def measure_residuals(errors: SensorErrors, array: Array, source: SampleSource, intensity_T: float) -> Residuals:
    """Return the root mean square residuals of a recording, as in ``residual_series``.

    Parameters
    ----------
    errors : SensorErrors
        By which the readings are corrected.
    array : Array
        Geometry of the K sensors.
    source : SampleSource
        Raw readings.
    intensity_T : float
        Intensity of the field where there is no scalar channel, tesla.
    """
    sums = ResidualSums(errors, array, intensity_T)
    for block in source.blocks():
        sums.add(block)
    return sums.result()


def _block_diagonal(matrices: FloatArray) -> FloatArray:
    """Return the (3K, 3K) matrix that applies (K, 3, 3) matrices to the vectors of each sensor."""
    count = len(matrices)
    return np.asarray(np.einsum("kl,kij->kilj", np.eye(count), matrices).reshape(3 * count, 3 * count))


def noise_floor(errors: SensorErrors, array: KnownNoiseArray, scalar_noise_T: float) -> Residuals:
    """Return the residuals that sensor noise alone leaves, whatever the calibration.

    The noise of an intensity is the mean over all directions of the noise along the field.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors, which turn the noise of readings into that of fields.
    array : KnownNoiseArray
        Geometry, and the noise of each sensor's axes.
    scalar_noise_T : float
        Standard deviation of the reference intensity, tesla; 0 where it is the true one.
    """
    unmix = errors.inverse
    sensor_variance = array.vector_noise_T**2 * (unmix**2).sum(axis=(1, 2)) / 3
    operator = np.einsum("rki,kij->rkj", array.operator.reshape(9, -1, 3), unmix).reshape(9, -1)
    output_variance = operator**2 @ np.repeat(array.vector_noise_T**2, 3)
    return Residuals(
        np.sqrt(sensor_variance + scalar_noise_T**2),
        float(np.sqrt(output_variance[:3].mean() + scalar_noise_T**2)),
        np.sqrt(output_variance[list(TENSOR_OUTPUTS)]),
    )
