"""What the judge says of one of the two recordings: diagnosis, calibration, and the noise that is left."""

from dataclasses import replace

import numpy as np
from numpy.linalg import lstsq

from tam_calibration.comparison.noise import noise_of
from tam_calibration.comparison.result import AxisNoise, Side
from tam_calibration.core.normal_equations import Elimination
from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.removal import agreed_field
from tam_calibration.gap.attitude_nominal import products_of
from tam_calibration.gap.calibration_with_effects import calibration_of
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.floor import Floor
from tam_calibration.gap.model import Model
from tam_calibration.gap.search import Progress
from tam_calibration.integrity import ACCEPTABLE
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray


def side_of(source: SampleSource, array: Array, progress: Progress | None = None) -> Side:
    """Return what the judge says of a recording.

    Parameters
    ----------
    source : SampleSource
        Raw readings (N, K, 3), tesla.
    array : Array
        Geometry and noise.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.

    Raises
    ------
    InputError
        When the recording cannot be used.
    Refused
        When it determines no calibration.
    """
    judgement = judge(source, array, progress=progress)
    gap, found, recording = judgement.gap, judgement.found, judgement.seen
    if found is None or gap.verdict == "not_identifiable":
        raise Refused(gap.statement)
    calibration = calibration_of(recording, found, gap, array, accept=ACCEPTABLE)
    residual, mixing = residual_of(calibration, recording, found.model)
    noise = noise_of(recording.time_s, residual[:, :-1], mixing, recording.interpolated_noise)
    if recording.scalar_T is not None:
        noise = (*noise, _noise_of_scalar(recording.time_s, residual[:, -1]))
    if gap.floor is not None:
        noise = tuple(_as_diagnosed(one, row, gap.floor, recording.sample_count) for row, one in enumerate(noise))
    return Side(recording, array, gap, calibration, residual, noise, found)


def _as_diagnosed(noise: AxisNoise, row: int, floor: Floor, count: int) -> AxisNoise:
    """Return white noise at the level that the diagnosis states of a cause, and of the scalar in any case."""
    is_cause = floor.is_diagnosed is not None and bool(floor.is_diagnosed[row])
    level_T = float(floor.level_T[row])
    if noise.colour != "white" or not (is_cause or noise.sensor == 0) or not np.isfinite(level_T):
        return noise
    # Of a cause by all its samples; else by the median power in the upper half of the band.
    error_T = level_T / float(np.sqrt(count)) * (np.sqrt(0.5) if is_cause else 1 / np.log(2))
    return replace(noise, level_T=level_T, white_T=level_T, level_error_T=error_T)


def residual_of(calibration: Calibration, recording: Recording, model: Model) -> tuple[FloatArray, FloatArray]:
    """Return what calibration and effects leave of the readings, and how it mixes the noise of the rows.

    The field of a sample is that on which the sensors agree; of one sensor that of the recorded attitude or, without
    one, its intensity alone.

    Parameters
    ----------
    calibration : Calibration
        With the effects that can be taken off.
    recording : Recording
        Of N samples and K sensors.
    model : Model
        Of the search; samples that it excludes are NaN.

    Returns
    -------
    residual : (N, 3K + 1) array
        Tesla; last the scalar less its mean.
    mixing : (3K, 3K) array
        M of e = M n, the residual of the noise n of the rows.
    """
    quiet = without_effects(calibration, recording, model)
    errors, row_count = calibration.errors, 3 * recording.sensor_count
    mixing = np.eye(row_count)
    if recording.sensor_count > 1:
        unmixing = Elimination.of_sensors(errors, calibration.array.vector_noise_T).unmixing
        mixing -= errors.matrix.reshape(row_count, 3) @ unmixing
    if recording.sensor_count > 1 or model.world is not None:
        left = quiet.readings_T - errors.distort(field_of(calibration, quiet, model))
        rows = left.reshape(recording.sample_count, row_count)
    else:
        intensity_T = np.linalg.norm(errors.restore(quiet.readings_T)[:, 0], axis=1)
        known_T = model.intensity_T if quiet.scalar_T is None else quiet.scalar_T
        rows = np.repeat((intensity_T - known_T)[:, None], row_count, axis=1)
    scalar = np.full(recording.sample_count, np.nan) if quiet.scalar_T is None else quiet.scalar_T
    residual = np.column_stack([rows, scalar - np.nanmean(scalar) if np.isfinite(scalar).any() else scalar])
    residual[~model.is_counted] = np.nan
    return residual, mixing


def without_effects(calibration: Calibration, recording: Recording, model: Model) -> Recording:
    """Return a recording without what the effects of its calibration add to it.

    Parameters
    ----------
    calibration : Calibration
        Of the recording.
    recording : Recording
        N samples of K sensors.
    model : Model
        Of the same samples, with the effects; of one sensor it knows the field better than its readings.
    """
    if model.world is None:
        return calibration.without_effects(recording)
    return model.quiet()


def field_of(calibration: Calibration, quiet: Recording, model: Model) -> FloatArray:
    """Return the field (N, 3) on which sensors agree; of one sensor that of the attitude, where it is known; tesla.

    Parameters
    ----------
    calibration : Calibration
        Of the recording.
    quiet : Recording
        N samples without what effects add.
    model : Model
        Of the same samples.
    """
    errors = calibration.errors
    if model.world is None:
        return agreed_field(quiet.readings_T, errors, calibration.array)
    assert model.recording.attitude is not None
    products = products_of(model.recording.attitude)
    smooth_T = products @ lstsq(products, quiet.readings_T[:, 0], rcond=None)[0]
    return errors.restore(smooth_T[:, None])[:, 0]


def _noise_of_scalar(time_s: FloatArray, scalar_T: FloatArray) -> AxisNoise:
    """Return the noise of the scalar: white, as what is slow in its readings is the field itself."""
    known = np.isfinite(scalar_T)
    noise = noise_of(time_s[known], scalar_T[known, None], np.eye(1))[0]
    return replace(
        noise,
        sensor=0,
        axis="",
        level_T=noise.white_T,
        colour="white",
        knee_hz=np.nan,
        exponent=np.nan,
        band_hz=None,
        band_T=0.0,
    )
