"""An alternating source, from the amplitudes that the sensors read of it."""

import numpy as np
from numpy.linalg import inv

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.source_completion import FEWEST_PERIODS, amplitudes_of, poses_of
from tam_calibration.localization.euler import DIPOLE_INDEX, locate, require_index
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.localization.survey import ARRAY_FRAME, WORLD_FRAME, Line, Overall, Survey
from tam_calibration.localization.turned_samples import locate_samples, turned
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import Spectrum, background_of, demodulate, find_frequency, turning_of

_HIGHEST_HZ = 1e6
"""Highest frequency of a source, hertz: no array samples twice as fast."""

_TURNING = (
    "The array never stood still: field and gradient were demodulated as they turned, and the error of finite "
    "baselines, (L/r)² of the distance at most, is not in the standard errors."
)


def locate_alternating(
    recording: Recording, calibration: Calibration, frequency_hz: float | None = None, *, index: float = DIPOLE_INDEX
) -> Survey:
    """Locate an alternating source; the array stays where it is, and may turn.

    Each axis of each sensor is demodulated, in each pose in which the array stood still for ten periods or more; where
    it never did, field and gradient are demodulated as they turn. Without attitude there is one pose. What the
    calibration does not know of gains counts for nothing beside the noise of the amplitudes.

    Parameters
    ----------
    recording : Recording
        Raw readings, with attitude where the array was turned.
    calibration : Calibration
        Of its array.
    frequency_hz : float, optional
        Of the source; found where it is not given.
    index : float
        Structural index.

    Raises
    ------
    InputError
        When the calibration is of another array, the frequency is none, or the recording is too short or too sparse.
    Refused
        When no line stands out of the noise, or no pose can be located.
    """
    require_index(index)
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    if frequency_hz is not None and not 0 < frequency_hz <= _HIGHEST_HZ:
        raise InputError(
            f"the frequency must be a positive number of hertz, at most {_HIGHEST_HZ:g}, not {frequency_hz:g}"
        )
    recording = calibration.without_effects(recording)
    if recording.attitude is not None:
        recording = recording.take(np.flatnonzero(np.isfinite(recording.attitude).all(axis=1)))
    line = _line(recording, frequency_hz)
    if recording.attitude is None:
        return _in_array_frame(recording, calibration, line, index)
    if not poses_of(recording, line.frequency_hz):
        return _turning(recording, calibration, line, index)
    found = amplitudes_of(recording, line.frequency_hz)
    solutions = turned(_locate(found.amplitudes_T, found.noise_T, calibration, index), found.poses.attitude)
    overall = _overall(solutions) if solutions.is_located.sum() > 1 else None
    return Survey(WORLD_FRAME, found.time_s, solutions, found.poses.position_m, overall, line=line)


def _line(recording: Recording, frequency_hz: float | None) -> Line:
    try:
        spectrum = _spectrum(recording)
    except (Refused, InputError):
        if frequency_hz is None:
            raise
        return Line(frequency_hz, np.nan, None)
    if frequency_hz is not None:
        return Line(frequency_hz, np.nan, spectrum)
    return Line(spectrum.peak_hz, spectrum.peak_standard_error_hz, spectrum)


def _spectrum(recording: Recording) -> Spectrum:
    """Return the spectrum from ten periods in the record to half the sampling rate."""
    channels = recording.readings_T.reshape(recording.sample_count, -1)
    span = float(np.ptp(recording.time_s))
    background = background_of(recording.time_s, recording.attitude)
    highest = 0.5 * (recording.sample_count - 1) / span
    return find_frequency(recording.time_s, channels, background, FEWEST_PERIODS / span, highest)


def _in_array_frame(recording: Recording, calibration: Calibration, line: Line, index: float) -> Survey:
    channels = recording.readings_T.reshape(recording.sample_count, -1)
    found = demodulate(recording.time_s, channels, line.frequency_hz, background_of(recording.time_s))
    solutions = _locate(found.amplitude[None], found.standard_errors[None], calibration, index)
    return Survey(ARRAY_FRAME, _middle(recording), solutions, np.zeros((1, 3)), line=line)


def _turning(recording: Recording, calibration: Calibration, line: Line, index: float) -> Survey:
    """Take field and gradient as they turn: their amplitudes rest in the world, where the array has no geometry."""
    assert recording.attitude is not None
    outputs = calibration.apply(recording.readings_T)[:, :8]
    background = background_of(recording.time_s, recording.attitude)
    turning = turning_of(recording.attitude, 8)
    found = demodulate(recording.time_s, outputs, line.frequency_hz, background, turning)
    solutions = locate(found.amplitude[None], found.covariance, index=index)
    return Survey(WORLD_FRAME, _middle(recording), solutions, np.zeros((1, 3)), line=line, note=_TURNING)


def _middle(recording: Recording) -> FloatArray:
    return np.asarray(np.mean(recording.time_s[[0, -1]], keepdims=True))


def _locate(amplitudes_T: FloatArray, noise_T: FloatArray, calibration: Calibration, index: float) -> EulerSolutions:
    matrix, count = calibration.correction_matrix, len(amplitudes_T)
    variance = noise_T.reshape(count, 1, -1) ** 2
    outputs = amplitudes_T.reshape(count, -1) @ matrix.T
    return locate_samples(outputs, calibration.array, (matrix * variance) @ matrix.T, index=index)


def _overall(solutions: EulerSolutions) -> Overall:
    """Return the mean of the poses, each weighed by its covariance; the moments first turned to one side."""
    at = np.flatnonzero(solutions.is_located)
    moments = solutions.moment_Am2[at]
    moments = moments * np.where(moments @ moments[0] < 0, -1, 1)[:, None]
    position, spread, chi_square = _weighted(solutions.position_m[at], solutions.position_covariance_m2[at])
    moment, moment_spread, _ = _weighted(moments, solutions.moment_covariance_A2m4[at])
    return Overall(position, spread, moment, moment_spread, chi_square, 3 * len(at) - 3)


def _weighted(values: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray, float]:
    if not np.isfinite(covariance).all():  # of moments, where the source is no dipole
        return np.full(3, np.nan), np.full((3, 3), np.nan), np.nan
    weights = inv(covariance)
    spread: FloatArray = inv(weights.sum(axis=0))
    mean = spread @ np.einsum("nij,nj->i", weights, values)
    rest = values - mean
    return mean, spread, float(np.einsum("ni,nij,nj->", rest, weights, rest))
