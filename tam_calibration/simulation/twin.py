"""The twin of a calibrated array: what it would have read on the run of a recording if the calibration were all."""

from dataclasses import replace

import numpy as np

from tam_calibration.calibration import Calibration
from tam_calibration.effects.effect import Situation
from tam_calibration.effects.removal import agreed_field, filled
from tam_calibration.recording import Recording
from tam_calibration.simulation.effects import add_effects


def twin(calibration: Calibration, recording: Recording, seed: int) -> Recording:
    """Return a recording with the field, attitude, temperature and current of another, and noise of its own.

    The field is what the sensors of the recording agree on; whatever else they differ in, the twin does not show.

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
    field = agreed_field(calibration.without_effects(recording).readings_T, errors, array)
    run = filled(recording)
    situation = Situation(run.time_s, field, errors, array, run.temperature_C, run.current_A, run.attitude)
    vector_noise, scalar_noise, *of_effects = np.random.default_rng(seed).spawn(2 + len(effects))
    rows = np.column_stack([errors.distort(field).reshape(len(field), -1), situation.intensity_T])
    rows = add_effects(rows, situation, effects, of_effects, "field")
    assert array.vector_noise_T is not None
    rows[:, :-1] += vector_noise.normal(0, np.repeat(array.vector_noise_T, 3), (len(field), situation.scalar_row))
    rows[:, -1] += scalar_noise.normal(0, array.scalar_noise_T or 0.0, len(field))
    rows = add_effects(rows, situation, effects, of_effects, "reading")
    scalar = None if recording.scalar_T is None else np.where(np.isfinite(recording.scalar_T), rows[:, -1], np.nan)
    return replace(recording, readings_T=rows[:, :-1].reshape(recording.readings_T.shape), scalar_T=scalar)
