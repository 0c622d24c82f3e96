"""The noise of a sensor in a recording that has not been calibrated: the fast part of its readings.

Noise is the fast part of what a sensor reads that motion does not make. High differences lose motion that is slow
against the sampling. Where that is not enough, what attitude explains is taken away before. Noise is as large along the
field as across it, and motion hardly changes the intensity: this separates noise from the motion that is left over.
"""

from math import comb

import numpy as np

from tam_calibration.core.noise import noise_deviation
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

ORDER = 8
"""Of the differences: a turn of 1 rad/s at 20 Hz leaves 1e-11 of the field; noise is a third as well known as by its
own values."""

_LAGS = np.arange(1, 13)
"""Samples on, at which noise is compared with white noise: a hum, which sensors share, does not die down in them."""

_OF_WHITE = np.array([(-1.0) ** lag * comb(2 * ORDER, ORDER + lag) / comb(2 * ORDER, ORDER) for lag in _LAGS])
"""Autocorrelation of the differences of white noise there."""

NO_NOISE_T = 2e-12
"""Rounding of the Earth's field to 32 bits makes 1e-12 T."""

FEWEST = 40
"""Samples: four for each of the ten numbers by which attitude explains an axis."""


def noise_sequence(recording: Recording, sensor: int) -> FloatArray | None:
    """Return differences (N - 8, 3) of the noise of a sensor, as large as it is; None where motion hides it.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    readings = recording.readings_T[:, sensor]
    if len(readings) < FEWEST:
        return None
    tried = [readings]
    # Of attitudes drawn anew for each sample attitude leaves every small effect, not noise alone.
    is_slow = _size(differences(readings)) < 0.5 * _size(readings - readings.mean(axis=0))
    if is_slow and (residual := _residual_from_attitude(recording, sensor)) is not None:
        tried.append(residual)
    return next((_without_jerks(differences(each)) for each in tried if _is_noise(each, readings)), None)


def _without_jerks(sequence_T: FloatArray) -> FloatArray:
    """Return differences (n, 3) with 0 for all that a jerk of the motion, which all sensors share, has a part in."""
    # Of noise one difference in 2 million is as large.
    is_jerk = np.abs(sequence_T) > 5.0 * noise_deviation(sequence_T, axis=0)
    touched = np.apply_along_axis(np.convolve, 0, is_jerk, np.ones(2 * ORDER + 1), "same") > 0
    return np.where(touched, 0.0, sequence_T)


def noise_level(recording: Recording, sensor: int) -> float | None:
    """Return the standard deviation of the white noise of the axes of a sensor, tesla; None where it is not known.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    sequence = noise_sequence(recording, sensor)
    return _size(sequence) if sequence is not None and all(map(is_white, sequence.T)) else None


def quietest(recording: Recording, sensor: int) -> float:
    """Return how much of a sensor's readings nothing explains, tesla: a bound of its noise that single samples raise.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    readings = recording.readings_T[:, sensor]
    if len(readings) < FEWEST:
        return float("inf")
    residuals = [_residual_from_attitude(recording, sensor), _residual_from_others(recording, sensor)]
    left = [readings, *(residual for residual in residuals if residual is not None)]
    return min(float(np.sqrt(np.mean(differences(each) ** 2))) for each in left)


def is_shared(recording: Recording, sensor: int) -> bool:
    """Whether the noise of a sensor is that of the others: they explain it, and the attitude does not.

    Parameters
    ----------
    recording : Recording
        Of N samples, tesla.
    sensor : int
        From 0.
    """
    own, noise = _residual_from_others(recording, sensor), _residual_from_attitude(recording, sensor)
    if recording.sample_count < FEWEST or own is None or noise is None:
        return False
    # Errors of the sensors leave less than a hundredth of the noise.
    is_little = _size(differences(own)) < 0.01 * _size(differences(noise))
    return is_little and _is_noise(noise, recording.readings_T[:, sensor])


def differences(values: FloatArray) -> FloatArray:
    """Return the differences along the first axis, as large as white noise is."""
    return np.asarray(np.diff(values, n=ORDER, axis=0) / np.sqrt(comb(2 * ORDER, ORDER)))


def is_white(sequence: FloatArray) -> bool:
    """Whether differences (n,), those of jerks 0, are those of white noise that is no rounding."""
    known = sequence != 0
    count = int(known.sum())
    power = float(sequence @ sequence)
    if 2 * count < len(sequence) or power <= count * NO_NOISE_T**2:
        return False
    lagged = np.array(
        [sequence[lag:] @ sequence[:-lag] / max(known[lag:] @ known[:-lag].astype(float), 1.0) for lag in _LAGS]
    )
    # Of 300 samples each autocorrelation has an error of 0.1.
    return bool((np.abs(lagged * count / power - _OF_WHITE) < 0.3).all())


def _is_noise(residual_T: FloatArray, readings_T: FloatArray) -> bool:
    """Whether what is left (N, 3) of readings (N, 3) is noise: as large along the readings as across them."""
    length = np.linalg.norm(readings_T, axis=1)
    along = np.sum(residual_T * readings_T, axis=1) / np.where(length > 0, length, 1)
    # Of white noise the part along the field is as large as that across it, of motion a twentieth.
    return _size(differences(along[:, None])) > 0.5 * _size(differences(residual_T))


def _residual_from_attitude(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what attitude does not explain of a sensor's readings, (N, 3)."""
    from scipy.spatial.transform import Rotation

    attitude = recording.attitude
    if attitude is None or not np.isfinite(attitude).all():
        return None
    return _residual_from(recording.readings_T[:, sensor], Rotation.from_quat(attitude).as_matrix().reshape(-1, 9))


def _residual_from_others(recording: Recording, sensor: int) -> FloatArray | None:
    """Return what the mean of the other sensors does not explain of a sensor's readings, (N, 3)."""
    if recording.sensor_count == 1:
        return None
    readings = recording.readings_T
    return _residual_from(readings[:, sensor], np.delete(readings, sensor, axis=1).mean(axis=1))


def _residual_from(readings_T: FloatArray, causes: FloatArray) -> FloatArray:
    """Return what causes (N, p) and a constant leave of readings (N, 3)."""
    design = np.column_stack([causes, np.ones(len(causes))])
    solution, _, rank, _ = np.linalg.lstsq(design, readings_T, rcond=1e-9)
    return np.asarray((readings_T - design @ solution) * np.sqrt(len(design) / (len(design) - rank)))


def _size(values_T: FloatArray) -> float:
    """Return the root mean square of the robust deviations of the columns."""
    return float(np.sqrt(np.mean(noise_deviation(values_T, axis=0) ** 2)))
