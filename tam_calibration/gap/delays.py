"""How much later than sensor 1's the readings of the other sensors are stamped, from the motion of the array.

A reading that is stamped a delay δ too late is short of the field by δ db/dt. The delays are fitted by Gauss-Newton
together with the errors of the sensors, whose regressors and the field of every sample are eliminated; each step brings
the readings to their times anew (Furgale, Rehder and Siegwart, Unified temporal and spatial calibration, IROS 2013).
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.core.interpolation import without_delays
from tam_calibration.effects.lags import TimeSkew
from tam_calibration.gap.model import Model
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Delays:
    """Delays of the sensors after sensor 1.

    Parameters
    ----------
    delay_s, standard_error_s : (K,) array
        Seconds; zero for sensor 1.
    """

    delay_s: FloatArray
    standard_error_s: FloatArray


def estimate_delays(recording: Recording, array: Array) -> Delays:
    """Return the delays of the sensors' stamps after those of sensor 1.

    Parameters
    ----------
    recording : Recording
        Readings (N, K, 3), tesla, of an array that was turned continuously: the faster, the smaller the errors.
    array : Array
        Geometry and noise of the K sensors.

    Returns
    -------
    Delays
        With standard errors that hold for the noise that the fit leaves.

    Raises
    ------
    InputError
        When there is one sensor only, or the array was not turned continuously.
    Refused
        When the readings are of no calibration, or the delays do not settle.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from tam_calibration import calibrate, estimate_delays, read_scenario, simulate
    >>> made = simulate(read_scenario("tumble_100_hz"))
    >>> delays = estimate_delays(made.recording, made.scenario.array)
    >>> bool((abs(delays.delay_s) < 1e-3).all())
    True
    >>> calibration = calibrate(made.recording, replace(made.scenario.array, delay_s=delays.delay_s))
    """
    if recording.sensor_count == 1:
        raise InputError("delays are those of further sensors after sensor 1: the array has one sensor only")
    delay = np.zeros(recording.sensor_count)
    first_s, last_s = recording.time_span_s
    # A delay of two samples takes three steps.
    for _ in range(12):
        moved = without_delays(recording, delay)
        # A delay that changes its sign would else lose a sample at one end and win one at the other, without end.
        first_s, last_s = max(first_s, moved.time_s[0]), min(last_s, moved.time_s[-1])
        step, error = _step(moved.take((moved.time_s >= first_s) & (moved.time_s <= last_s)), array)
        delay[1:] += step
        if np.all(np.abs(step) <= 0.01 * error):
            return Delays(delay, np.concatenate([[0.0], error]))
    raise Refused("the delays of the sensors do not settle: more than their delays is unknown; try tam diagnose")


def _step(recording: Recording, array: Array) -> tuple[FloatArray, FloatArray]:
    """Return by how much the delays of sensors 2 to K are still wrong, and their standard errors, seconds."""
    base = Model.nominal(recording, array).base()
    channels, effect = base.channels, TimeSkew()
    if (obstacle := effect.obstacle(channels.covariates)) is not None:
        raise InputError(f"the delays of the sensors cannot be told: {obstacle}; {effect.excitation}")
    others = range(1, recording.sensor_count)
    terms = [term for term in effect.terms(channels.covariates, {}) if term.axis is None and term.sensor in others]
    projected = base.project(channels.design(terms))
    inverse, visible = projected.inverse()
    if visible < len(others):
        raise InputError(f"the delays of the sensors cannot be told from this motion; {effect.excitation}")
    step = inverse @ projected.score
    energy = base.energy - projected.score @ step
    variance = energy / max(channels.count - base.rank - len(step), 1.0)
    return step, np.sqrt(variance * np.diag(inverse))
