"""Sound recordings of arrays with random errors, from which cases of ``dependent_channels`` are made."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

WORLD_T = np.array([1.5e-6, 19e-6, -45e-6])
"""East, north, up: middle latitudes, with five degrees of declination."""

RATE_HZ, START_S = 10.0, 1.7e9
"""Of samples; and a date, without which priors do not age."""


@dataclass(frozen=True, eq=False)
class Case:
    """A recording, its array, the truth, and what is given to the calibration beside it."""

    recording: Recording
    array: Array
    errors: SensorErrors
    rotation: Rotation
    prior: Calibration | None = None
    main_field_T: FloatArray | None = None

    def with_attitude(self, rotation: Rotation) -> "Case":
        """Return the case with another recorded attitude."""
        return replace(self, recording=replace(self.recording, attitude=rotation.as_quat()))


def random_errors(rng: Generator, count: int) -> SensorErrors:
    """Return errors from those of a fluxgate to those of a chip beside iron."""
    bias_T = 10 ** rng.uniform(-7.3, -5.7)
    size = np.repeat([10 ** rng.uniform(-2.5, -1.5), np.radians(0.5), bias_T, np.radians(0.5)], 3)
    errors = rng.normal(size=(count, 12)) * size
    errors[:, :3] += 1
    return SensorErrors.from_vector(errors)


def motion_of(rng: Generator, time_s: FloatArray, way: int) -> Rotation:
    """Return full circles with some tilt, swings of a few degrees about all axes, or turns all round."""
    tilt, period_s = np.radians(rng.uniform(3, 30)), rng.uniform(20, 60)
    phase = 2 * np.pi * (time_s[:, None] / period_s * [1.0, 1.618, 2.618] + rng.uniform(size=3))
    swing = np.sin(phase)
    if way == 0:
        angles = np.column_stack([phase[:, 0], tilt * swing[:, 1:]])
    elif way == 1:
        angles = np.radians(rng.uniform(4, 15)) * swing
    else:
        angles = phase / [1.0, 1.618, 1.618**3]
    return Rotation.from_euler("ZYX", angles)


def sound(rng: Generator, way: int | None = None) -> Case:
    """Return a sound case without attitude."""
    way = int(rng.integers(3)) if way is None else way
    count, samples = int(rng.choice([1, 2, 4, 4])), int(rng.choice([600, 1200]))
    noise_T = float(rng.choice([1e-9, 5e-9, 20e-9]))
    time_s = np.arange(samples) / RATE_HZ
    rotation, errors = motion_of(rng, time_s, way), random_errors(rng, count)
    array = Array(Array.cross(0.5).positions_m[:count], np.full(count, noise_T), noise_T / 10)
    return recorded(rng, array, errors, rotation, time_s)


def recorded(rng: Generator, array: Array, errors: SensorErrors, rotation: Rotation, time_s: FloatArray) -> Case:
    """Return what sensors read on a turn in a field that pulsates by 0.1 to 5 nT, with white noise."""
    known = array.with_stated_noise()
    size, period_s = 10 ** rng.uniform(-10, -8.3) / norm(WORLD_T), rng.uniform(10, 200)
    field_T = rotation.inv().apply(WORLD_T)
    field_T *= 1 + size * np.sin(2 * np.pi * (time_s / period_s + rng.uniform()))[:, None]
    readings_T = errors.distort(field_T)
    readings_T += rng.normal(size=readings_T.shape) * known.vector_noise_T[:, None]
    scalar_T = norm(field_T, axis=1) + rng.normal(0, known.scalar_noise_T, len(field_T))
    return Case(Recording(START_S + time_s, readings_T, scalar_T), array, errors, rotation)


def noisy(rng: Generator, rotation: Rotation, deviation: float, lasting_s: float = 0.0) -> Rotation:
    """Return attitudes in error about each axis, from sample to sample or for some seconds."""
    error = rng.normal(0, deviation, (len(rotation), 3))
    if lasting_s:
        kept = np.exp(-1 / (lasting_s * RATE_HZ))
        for index in range(1, len(error)):
            error[index] = kept * error[index - 1] + np.sqrt(1 - kept**2) * error[index]
    return rotation * Rotation.from_rotvec(error)


def sound_attitude(rng: Generator) -> Case:
    """Return a case with a sound attitude, its noise stated or to be estimated."""
    case, size = sound(rng), np.radians(10 ** rng.uniform(-1.3, 0.0))
    lasting_s = float(rng.choice([0.0, 0.0, 2.0]))
    stated = size if rng.random() < 0.5 and not lasting_s else np.inf
    case = case.with_attitude(noisy(rng, case.rotation, size, lasting_s))
    return replace(case, array=replace(case.array, attitude_noise=stated))


def next_day(rng: Generator, pier: Case, before: Calibration, errors: SensorErrors) -> Case:
    """Return a narrow turn a day after a calibration, by which it is the prior."""
    time_s = 86400 + np.arange(pier.recording.sample_count) / RATE_HZ
    dive = recorded(rng, pier.array, errors, motion_of(rng, time_s, int(rng.integers(2))), time_s)
    return replace(dive, prior=before)
