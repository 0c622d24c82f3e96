"""The twin of a calibrated array: what it would have read on the run of a recording if the calibration were all."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.effects.removal import agreed_field, filled, removable
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.observe import add_effects


def twin(calibration: Calibration, recording: Recording, seed: int) -> Recording:
    """Return a recording with the field, attitude, temperature and current of another, and noise of its own.

    The field is what the sensors of the recording agree on, without axes that round, end or jump; whatever else they
    differ in, the twin does not show.

    Parameters
    ----------
    calibration : Calibration
        Errors, noise and effects of the array.
    recording : Recording
        The run.
    seed : int
        Of all random numbers.

    Raises
    ------
    InputError
        When the recording is of another number of sensors, or lacks a channel that an effect needs.
    """
    array, errors, effects = calibration.array, calibration.errors, calibration.effects
    field = agreed_field(calibration.without_effects(recording).readings_T, errors, array, _is_trusted(calibration))
    run = filled(recording)
    covariates = Covariates(
        run.time_s, field, errors, array, run.temperature_C, run.current_A, run.attitude, further=run.further
    )
    vector_noise, scalar_noise, *of_effects = np.random.default_rng(seed).spawn(2 + len(effects))
    rows = np.column_stack([errors.distort(field).reshape(len(field), -1), covariates.intensity_T])
    rows = add_effects(rows, covariates, effects, of_effects, "field")
    vector_T, scalar_T = _noise(calibration)
    rows[:, :-1] += vector_noise.normal(0, np.repeat(vector_T, 3), (len(field), covariates.scalar_row))
    rows[:, -1] += scalar_noise.normal(0, scalar_T, len(field))
    rows = add_effects(rows, covariates, effects, of_effects, "reading")
    scalar = None if recording.scalar_T is None else np.where(np.isfinite(recording.scalar_T), rows[:, -1], np.nan)
    return replace(recording, readings_T=rows[:, :-1].reshape(recording.readings_T.shape), scalar_T=scalar)


def _is_trusted(calibration: Calibration) -> NDArray[np.bool_]:
    """Return which axes (3K,) hold no effect that cannot be taken off; all where the others tell no field."""
    matrix = calibration.errors.matrix.reshape(-1, 3)
    is_trusted = np.ones(len(matrix), dtype=bool)
    staying = [fitted for fitted in calibration.effects if not removable([fitted])]
    for part in (part for fitted in staying for part in fitted.contributions if part.sensor >= 0):
        first = 3 * part.sensor
        is_trusted[slice(first, first + 3) if part.axis is None else first + part.axis] = False
    return is_trusted if np.linalg.matrix_rank(matrix[is_trusted]) == 3 else np.ones_like(is_trusted)


def _noise(calibration: Calibration) -> tuple[FloatArray, float]:
    """Return the noise of the sensors (K,) and of the scalar: that stated, as much larger or smaller as was found.

    Where effects are not taken off the residuals, these are no measure of the noise.
    """
    array, left = calibration.array, calibration.reduced_chi_square
    if removable(calibration.effects) != calibration.effects:
        left = {}
    vector, scalar = (min(np.sqrt(left.get(name, 1.0)), LARGEST_NOISE) for name in ("differential", "common_mode"))
    return vector * array.vector_noise_T, float(scalar * array.scalar_noise_T)
