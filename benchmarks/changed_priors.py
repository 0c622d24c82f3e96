"""Cases of ``dependent_channels`` with a prior of the day before, since when the sensors have changed.

Each function of this module changes the errors (K, 12) of the K sensors, and becomes one that returns the case.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import wraps

import numpy as np
from dependent_cases import Case, next_day, random_errors, sound
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


def _since(change: Callable[[Generator, FloatArray], None]) -> Callable[[Generator], Case]:
    @wraps(change)
    def make(rng: Generator) -> Case:
        pier = sound(rng, 2)
        before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
        change(rng, vector)
        return next_day(rng, pier, before, SensorErrors.from_vector(vector))

    return make


@_since
def knocked(rng: Generator, vector: FloatArray) -> None:
    """Move the biases of one sensor."""
    vector[rng.integers(len(vector)), 6:9] += 10 ** rng.uniform(-8, -6) * rng.normal(size=3)


@_since
def replaced(rng: Generator, vector: FloatArray) -> None:
    """Take other sensors."""
    vector[:] = random_errors(rng, len(vector)).to_vector()


def leaking(rng: Generator) -> Case:
    """Return a case with a temperature that follows the readings of sensor 1, beside a prior."""
    pier = sound(rng, 2)
    before = calibrate(replace(pier.recording, temperature_C=np.full(pier.recording.sample_count, 20.0)), pier.array)
    dive = next_day(rng, pier, before, pier.errors)
    leak_C = 15 + 1e6 * dive.recording.readings_T[:, 0, 0] * rng.uniform(-0.5, 0.5)
    return replace(dive, recording=replace(dive.recording, temperature_C=leak_C))


@_since
def turned_since(rng: Generator, vector: FloatArray) -> None:
    """Turn one sensor, or change its gain."""
    size = 10 ** rng.uniform(-3.5, -1.5)
    some = np.s_[9:12] if len(vector) > 1 and rng.random() < 0.5 else np.s_[:3]
    vector[rng.integers(1, len(vector)) if len(vector) > 1 else 0, some] += size * rng.normal(size=3)


@_since
def exchanged_since(rng: Generator, vector: FloatArray) -> None:
    """Exchange two sensors, or move all biases."""
    if len(vector) > 1 and rng.random() < 0.5:
        vector[[0, 1]] = vector[[1, 0]]
    else:
        vector[:, 6:9] += 10 ** rng.uniform(-8, -6) * rng.normal(size=(len(vector), 3))


@_since
def heated(rng: Generator, vector: FloatArray) -> None:
    """Warm all sensors, while no temperature is recorded."""
    warming_K = rng.uniform(2, 30)
    vector[:, :3] += 20e-6 * warming_K * rng.normal(size=(len(vector), 3))
    vector[:, 6:9] += 0.3e-9 * warming_K * rng.normal(size=(len(vector), 3))


@_since
def magnetised(rng: Generator, vector: FloatArray) -> None:
    """Magnetise the vehicle, and add iron that all sensors feel."""
    vector[:, 6:9] += 10 ** rng.uniform(-8.5, -6.5) * rng.normal(size=(len(vector), 3))
    vector[:, :6] += 10 ** rng.uniform(-4.5, -2.5) * rng.normal(size=6)


@_since
def aged(rng: Generator, vector: FloatArray) -> None:
    """Change all errors two to thirty times faster than stated."""
    size = np.sqrt(ChangeRates().variances(DAY_S * 10 ** rng.uniform(0.6, 3.0), 0.0))
    vector += size * rng.normal(size=vector.shape)


@_since
def bent(rng: Generator, vector: FloatArray) -> None:
    """Bend the frame, and knock one sensor."""
    vector[:, 9:] += np.radians(10 ** rng.uniform(-2, 0)) * rng.normal(size=(len(vector), 3))
    vector[rng.integers(len(vector)), 6:9] += 10 ** rng.uniform(-8.5, -6.5) * rng.normal(size=3)


@_since
def repaired(rng: Generator, vector: FloatArray) -> None:
    """Repair one sensor: all its errors change slightly."""
    size = 10 ** rng.uniform(-4, -2) * np.repeat([1.0, 1.0, 5e-5, 1.0], 3)
    vector[rng.integers(len(vector))] += size * rng.normal(size=12)


@_since
def amplified(rng: Generator, vector: FloatArray) -> None:
    """Change gains and offsets of the channels of one axis."""
    axis = rng.integers(3)
    vector[:, axis] += 10 ** rng.uniform(-4, -2) * rng.normal(size=len(vector))
    vector[:, 6 + axis] += 10 ** rng.uniform(-9, -7) * rng.normal(size=len(vector))


@_since
def magnet_aboard(rng: Generator, vector: FloatArray) -> None:
    """Leave a magnet and a tool of iron near one end of the array."""
    distance = norm(Array.cross(0.5).positions_m[: len(vector)] - rng.normal(0, 0.5, 3), axis=1) + 0.3
    vector[:, 6:9] += (10 ** rng.uniform(-9, -7) * rng.normal(size=3))[None] / distance[:, None] ** 3
    vector[:, :3] += (10 ** rng.uniform(-5, -3.5) * rng.normal(size=3))[None] / distance[:, None] ** 3


@_since
def cooled(rng: Generator, vector: FloatArray) -> None:
    """Cool each sensor by itself, by coefficients of data sheets."""
    for each in vector:
        each += np.sqrt(ChangeRates().variances(0.0, rng.uniform(0, 25))) * rng.uniform(-1.7, 1.7, 12)


@_since
def remounted(rng: Generator, vector: FloatArray) -> None:
    """Mount two sensors anew, one of them after it was near a tool."""
    vector[-2:, 9:] += np.radians(10 ** rng.uniform(-1.5, 0.5)) * rng.normal(size=(len(vector[-2:]), 3))
    vector[-1, 6:9] += 10 ** rng.uniform(-8.5, -7) * rng.normal(size=3)
