"""How calibration answers channels that depend on what it calibrates.

Run ``python benchmarks/dependent_channels.py --half made|judged [--runs 200] [--first-seed 1]``.

Each run is a simulated recording of one to four sensors with random errors, turned in full circles, in swings of a few
degrees, or all round, and calibrated with one channel that is wrong: an attitude that takes its heading from the raw
readings, a late attitude, a scalar beside a magnet or a current, a wrong place, a prior of sensors that have changed,
or a temperature that follows the readings. The rules were made on the kinds ``made`` and are judged on the others.
Counted are runs that are refused, and those whose answer is more than 4 of its standard errors off in any parameter,
with or without a warning. As many sound runs are counted where a channel is left out, a warning is given or the run is
refused although it is calibrated from the true attitude.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import click
import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from rich.progress import track
from scipy.spatial.transform import Rotation, Slerp
from spread import Row, show

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.posterior import Known
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.model.array import Array
from tam_calibration.model.change_rates import ChangeRates
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

WORLD_T = np.array([1.5e-6, 19e-6, -45e-6])
"""East, north, up: middle latitudes, with five degrees of declination."""

RATE_HZ, FAR, START_S = 10.0, 4.0, 1.7e9
"""Of samples; standard errors from which an answer is far off; and a date, without which priors do not age."""


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
    size, period_s = 10 ** rng.uniform(-10, -8.3) / norm(WORLD_T), rng.uniform(10, 200)
    field_T = rotation.inv().apply(WORLD_T)
    field_T *= 1 + size * np.sin(2 * np.pi * (time_s / period_s + rng.uniform()))[:, None]
    readings_T = errors.distort(field_T)
    readings_T += rng.normal(size=readings_T.shape) * array.vector_noise_T[:, None]
    scalar_T = norm(field_T, axis=1) + rng.normal(0, array.scalar_noise_T, len(field_T))
    return Case(Recording(START_S + time_s, readings_T, scalar_T), array, errors, rotation)


def noisy(rng: Generator, rotation: Rotation, deviation: float, lasting_s: float = 0.0) -> Rotation:
    """Return attitudes in error about each axis, from sample to sample or for some seconds."""
    error = rng.normal(0, deviation, (len(rotation), 3))
    if lasting_s:
        kept = np.exp(-1 / (lasting_s * RATE_HZ))
        for index in range(1, len(error)):
            error[index] = kept * error[index - 1] + np.sqrt(1 - kept**2) * error[index]
    return rotation * Rotation.from_rotvec(error)


def heading(field_T: FloatArray) -> FloatArray:
    """Return the angle of vectors (N, 3) about the vertical."""
    return np.arctan2(field_T[:, 1], field_T[:, 0])


def compass(rng: Generator, case: Case, readings_T: FloatArray, filter_s: float = 0.0, delay_s: float = 0.0) -> Case:
    """Return the case with the attitude of an AHRS: level by gravity, its heading from readings (N, 3)."""
    tilt = np.radians(10 ** rng.uniform(-1.5, -0.3))
    _, pitch, roll = noisy(rng, case.rotation, tilt).as_euler("ZYX").T
    level = Rotation.from_euler("YX", np.column_stack([pitch, roll]))
    true_yaw = case.rotation.as_euler("ZYX")[:, 0]
    wrong = heading(WORLD_T[None])[0] - heading(level.apply(readings_T)) - true_yaw
    wrong = (wrong + np.pi) % (2 * np.pi) - np.pi
    if filter_s:
        kept = np.exp(-1 / (filter_s * RATE_HZ))
        for index in range(1, len(wrong)):
            wrong[index] = kept * wrong[index - 1] + (1 - kept) * wrong[index]
    seen = Rotation.from_euler("ZYX", np.column_stack([true_yaw + wrong, pitch, roll]))
    case = case.with_attitude(delayed(seen, delay_s))
    rms = float(np.sqrt(np.mean((case.rotation.inv() * Rotation.from_quat(case.recording.attitude)).magnitude() ** 2)))
    stated = [np.radians(0.1), min(max(rms, 1e-3), 0.4), np.inf][rng.integers(3)]
    return replace(case, array=replace(case.array, attitude_noise=stated))


def delayed(rotation: Rotation, delay_s: float) -> Rotation:
    """Return attitudes that come late."""
    time_s = np.arange(len(rotation)) / RATE_HZ
    return Slerp(time_s, rotation)(np.maximum(time_s - delay_s, 0)) if delay_s else rotation


def _raw(rng: Generator) -> Case:
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T[:, 0])


def _filtered(rng: Generator) -> Case:
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T[:, 0], filter_s=10 ** rng.uniform(-0.3, 1.3))


def _late(rng: Generator) -> Case:
    case = sound(rng)
    size = np.radians(10 ** rng.uniform(-1.3, -0.3))
    late = delayed(noisy(rng, case.rotation, size), rng.uniform(0.05, 0.5))
    return replace(case.with_attitude(late), array=replace(case.array, attitude_noise=[size, np.inf][rng.integers(2)]))


def _beside_magnet(rng: Generator) -> Case:
    """Return a case with a constant field at the scalar, which then depends on the direction of the Earth's field."""
    case = sound(rng, int(rng.choice([0, 2])))
    magnet_T = 10 ** rng.uniform(-9, -7) * rng.normal(size=3)
    field_T = case.rotation.inv().apply(WORLD_T)
    added_T = norm(field_T + magnet_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def _knocked(rng: Generator) -> Case:
    """Return a case with a prior of the day before, since when the biases of one sensor have moved."""
    pier = sound(rng, 2)
    before = calibrate(pier.recording, pier.array)
    vector = pier.errors.to_vector()
    vector[rng.integers(len(vector)), 6:9] += 10 ** rng.uniform(-8, -6) * rng.normal(size=3)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _next_day(rng: Generator, pier: Case, before: Calibration, errors: SensorErrors) -> Case:
    time_s = 86400 + np.arange(pier.recording.sample_count) / RATE_HZ
    dive = recorded(rng, pier.array, errors, motion_of(rng, time_s, int(rng.integers(2))), time_s)
    return replace(dive, prior=before)


def _mean(rng: Generator) -> Case:
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T.mean(axis=1))


def _precorrected(rng: Generator) -> Case:
    """Return a case with an AHRS that takes off horizontal biases of an earlier day."""
    case = sound(rng)
    known_T = case.errors.bias_T[0] * [1.0, 1.0, 0.0] * rng.uniform(0.7, 1.1)
    return compass(rng, case, case.recording.readings_T[:, 0] - known_T, filter_s=float(rng.choice([0.0, 1.0])))


def _late_compass(rng: Generator) -> Case:
    case = sound(rng)
    sensor = rng.integers(case.array.sensor_count)
    readings_T = case.recording.readings_T[:, sensor]
    return compass(rng, case, readings_T, filter_s=rng.uniform(0.2, 3), delay_s=rng.uniform(0.05, 0.3))


def _beside_current(rng: Generator) -> Case:
    """Return a case with the field of a load at the scalar, which is switched as the vehicle turns."""
    case = sound(rng, int(rng.choice([0, 2])))
    field_T = case.rotation.inv().apply(WORLD_T)
    is_on = heading(field_T) > rng.uniform(-1, 1)
    load_T = 10 ** rng.uniform(-8.5, -7) * rng.normal(size=3) * is_on[:, None]
    added_T = norm(field_T + load_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def _wrong_place(rng: Generator) -> Case:
    """Return a case with the field of a place far away, beside a scalar and a sound attitude."""
    case = sound_attitude(rng)
    return replace(
        case, main_field_T=Rotation.from_rotvec(rng.normal(0, 0.3, 3)).apply(WORLD_T) * rng.uniform(0.8, 1.2)
    )


def _replaced(rng: Generator) -> Case:
    """Return a case with a prior of other sensors."""
    pier = sound(rng, 2)
    before = calibrate(pier.recording, pier.array)
    return _next_day(rng, pier, before, random_errors(rng, pier.array.sensor_count))


def _leaking(rng: Generator) -> Case:
    """Return a case with a temperature that follows the readings of sensor 1, beside a prior."""
    pier = sound(rng, 2)
    before = calibrate(replace(pier.recording, temperature_C=np.full(pier.recording.sample_count, 20.0)), pier.array)
    dive = _next_day(rng, pier, before, pier.errors)
    leak_C = 15 + 1e6 * dive.recording.readings_T[:, 0, 0] * rng.uniform(-0.5, 0.5)
    return replace(dive, recording=replace(dive.recording, temperature_C=leak_C))


def sound_attitude(rng: Generator) -> Case:
    """Return a case with a sound attitude, its noise stated or to be estimated."""
    case, size = sound(rng), np.radians(10 ** rng.uniform(-1.3, 0.0))
    lasting_s = float(rng.choice([0.0, 0.0, 2.0]))
    stated = size if rng.random() < 0.5 and not lasting_s else np.inf
    case = case.with_attitude(noisy(rng, case.rotation, size, lasting_s))
    return replace(case, array=replace(case.array, attitude_noise=stated))


def _circle_fitted(rng: Generator) -> Case:
    """Return a case with an AHRS that takes off the middle of the levelled readings of sensor 1 over the recording."""
    case = sound(rng, 0)
    level = Rotation.from_euler("YX", case.rotation.as_euler("ZYX")[:, 1:])
    levelled = level.apply(case.recording.readings_T[:, 0])
    middle_T = (levelled.max(axis=0) + levelled.min(axis=0)) / 2 * [1.0, 1.0, 0.0]
    return compass(rng, case, level.inv().apply(levelled - middle_T))


def _field_first(rng: Generator) -> Case:
    """Return a case with an attitude that turns the reading of a sensor into the world's field, then levels."""
    case = sound(rng)
    reading_T = case.recording.readings_T[:, rng.integers(case.array.sensor_count)]
    down = case.rotation.inv().apply([0.0, 0.0, -1.0]) + rng.normal(0, 1e-3, reading_T.shape)
    seen = np.stack([reading_T, np.cross(down, reading_T)], axis=1)
    seen = np.stack([*np.moveaxis(seen, 1, 0), np.cross(seen[:, 0], seen[:, 1])], axis=2)
    world = np.stack([WORLD_T, np.cross([0.0, 0.0, -1.0], WORLD_T)], axis=0)
    world = np.stack([*world, np.cross(*world)], axis=1)
    turns = (world / norm(world, axis=0)) @ np.swapaxes(seen / norm(seen, axis=1)[:, None], 1, 2)
    stated = [np.radians(0.1), np.radians(1.0), np.inf][rng.integers(3)]
    return replace(case.with_attitude(Rotation.from_matrix(turns)), array=replace(case.array, attitude_noise=stated))


def _gyroscope_scale(rng: Generator) -> Case:
    """Return a case with a heading whose gyroscope is wrong by up to some parts in a hundred."""
    case = sound_attitude(rng)
    yaw, pitch, roll = Rotation.from_quat(case.recording.attitude).as_euler("ZYX").T
    yaw = np.unwrap(yaw)
    yaw = yaw[0] + (yaw - yaw[0]) * (1 + 10 ** rng.uniform(-3.5, -1.5))
    return case.with_attitude(Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])))


def _beside_iron(rng: Generator) -> Case:
    """Return a case with soft iron beside the scalar."""
    case = sound(rng, int(rng.choice([0, 2])))
    along = rng.normal(size=3)
    field_T = case.rotation.inv().apply(WORLD_T)
    induced_T = 10 ** rng.uniform(-4.5, -2.5) * (field_T @ along)[:, None] * along
    added_T = norm(field_T + induced_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def _heading_error(rng: Generator) -> Case:
    """Return a case with a scalar of optical pumping, which reads otherwise on either side of its axis."""
    case = sound(rng, int(rng.choice([0, 2])))
    axis = rng.normal(size=3)
    cosine = case.rotation.inv().apply(WORLD_T) @ axis / norm(axis) / norm(WORLD_T)
    added_T = 10 ** rng.uniform(-9.3, -7.5) * np.tanh(cosine / 0.3)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def _wrong_declination(rng: Generator) -> Case:
    """Return a case with the field of a place, beside an attitude that counts from another north."""
    case = sound_attitude(rng)
    turn = Rotation.from_rotvec([0.0, 0.0, rng.choice([-1, 1]) * rng.uniform(0.05, 0.6)])
    return replace(case, main_field_T=turn.apply(WORLD_T))


def _turned_since(rng: Generator) -> Case:
    """Return a case with a prior of the day before, since when one sensor was turned, or its gain has changed."""
    pier = sound(rng, 2)
    before = calibrate(pier.recording, pier.array)
    vector, size = pier.errors.to_vector(), 10 ** rng.uniform(-3.5, -1.5)
    some = np.s_[9:12] if len(vector) > 1 and rng.random() < 0.5 else np.s_[:3]
    vector[rng.integers(1, len(vector)) if len(vector) > 1 else 0, some] += size * rng.normal(size=3)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _exchanged_since(rng: Generator) -> Case:
    """Return a case with a prior of the day before, since when two sensors were exchanged or all biases have moved."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    if len(vector) > 1 and rng.random() < 0.5:
        vector[[0, 1]] = vector[[1, 0]]
    else:
        vector[:, 6:9] += 10 ** rng.uniform(-8, -6) * rng.normal(size=(len(vector), 3))
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _heated(rng: Generator) -> Case:
    """Return a case with a prior since which all sensors have warmed, while no temperature was recorded."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    warming_K = rng.uniform(2, 30)
    vector[:, :3] += 20e-6 * warming_K * rng.normal(size=(len(vector), 3))
    vector[:, 6:9] += 0.3e-9 * warming_K * rng.normal(size=(len(vector), 3))
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _magnetised(rng: Generator) -> Case:
    """Return a case with a prior since which the vehicle was magnetised, and iron was added that all sensors feel."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    vector[:, 6:9] += 10 ** rng.uniform(-8.5, -6.5) * rng.normal(size=(len(vector), 3))
    vector[:, :6] += 10 ** rng.uniform(-4.5, -2.5) * rng.normal(size=6)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _aged(rng: Generator) -> Case:
    """Return a case with a prior since which all errors changed two to thirty times faster than stated."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    size = np.sqrt(ChangeRates().variances(86400 * 10 ** rng.uniform(0.6, 3.0), 0.0))
    vector += size * rng.normal(size=vector.shape)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _bent(rng: Generator) -> Case:
    """Return a case with a prior since which the frame was bent, and one sensor was knocked."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    vector[:, 9:] += np.radians(10 ** rng.uniform(-2, 0)) * rng.normal(size=(len(vector), 3))
    vector[rng.integers(len(vector)), 6:9] += 10 ** rng.uniform(-8.5, -6.5) * rng.normal(size=3)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _repaired(rng: Generator) -> Case:
    """Return a case with a prior since which one sensor was repaired: all its errors are slightly others."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    size = 10 ** rng.uniform(-4, -2) * np.repeat([1.0, 1.0, 5e-5, 1.0], 3)
    vector[rng.integers(len(vector))] += size * rng.normal(size=12)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


MADE: dict[str, Callable[[Generator], Case]] = {
    "AHRS of sensor 1": _raw,
    "filtered AHRS of sensor 1": _filtered,
    "AHRS of all sensors": _mean,
    "AHRS with old biases": _precorrected,
    "late filtered AHRS": _late_compass,
    "late attitude": _late,
    "scalar beside a magnet": _beside_magnet,
    "scalar beside a current": _beside_current,
    "wrong place": _wrong_place,
    "prior of one bias ago": _knocked,
    "prior of other sensors": _replaced,
    "temperature that leaks": _leaking,
    "AHRS that fits a circle": _circle_fitted,
    "attitude by the field first": _field_first,
    "gyroscope's scale": _gyroscope_scale,
    "scalar beside iron": _beside_iron,
    "scalar's heading error": _heading_error,
    "wrong declination": _wrong_declination,
    "prior of a turn or gain ago": _turned_since,
    "prior of all sensors ago": _exchanged_since,
    "prior of a colder day": _heated,
    "prior of another vehicle's field": _magnetised,
    "prior that aged faster": _aged,
    "prior of a straight frame": _bent,
    "prior before a repair": _repaired,
}


def _another_compass(rng: Generator) -> Case:
    """Return a case with an AHRS of a magnetometer that is not calibrated."""
    case = sound(rng)
    other = random_errors(rng, 1).distort(case.rotation.inv().apply(WORLD_T))
    return compass(rng, case, other[:, 0], filter_s=float(rng.choice([0.0, 3.0])))


def _thrown(rng: Generator) -> Case:
    """Return a case with an attitude that takes the acceleration of turns for gravity."""
    case = sound_attitude(rng)
    rate = np.gradient(np.unwrap(case.rotation.as_euler("ZYX")[:, 0]), 1 / RATE_HZ)
    tilt = np.radians(10 ** rng.uniform(-1, 0.7)) * rate / np.abs(rate).max()
    seen = Rotation.from_quat(case.recording.attitude) * Rotation.from_euler("X", tilt[:, None])
    return case.with_attitude(seen)


def _jittering(rng: Generator) -> Case:
    """Return a case with attitudes of other times than their stamps say."""
    case = sound_attitude(rng)
    time_s = np.arange(len(case.rotation)) / RATE_HZ
    late_s = time_s - rng.uniform(0, rng.uniform(0.02, 0.5), len(time_s))
    return case.with_attitude(Slerp(time_s, case.rotation)(np.clip(late_s, 0, None)))


def _beside_metal(rng: Generator) -> Case:
    """Return a case with a scalar in a housing that conducts: currents follow the change of the field."""
    case = sound(rng, int(rng.choice([0, 2])))
    field_T = case.rotation.inv().apply(WORLD_T)
    current_T = 10 ** rng.uniform(-3.5, -1.5) * np.gradient(field_T, 1 / RATE_HZ, axis=0) * rng.uniform(0.3, 1, 3)
    added_T = norm(field_T + current_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def _dead_zone(rng: Generator) -> Case:
    """Return a case with a scalar that is missing near its axis, and reads too much beside that."""
    case = sound(rng, int(rng.choice([0, 2])))
    axis = rng.normal(size=3)
    cosine = np.abs(case.rotation.inv().apply(WORLD_T) @ axis) / norm(axis) / norm(WORLD_T)
    added_T = 10 ** rng.uniform(-9.3, -7.5) * np.exp((cosine - 0.8) / 0.1)
    scalar_T = np.where(cosine > 0.8, np.nan, case.recording.scalar_T + added_T)
    return replace(case, recording=replace(case.recording, scalar_T=scalar_T))


def _amplified(rng: Generator) -> Case:
    """Return a case with a prior since which the channels of one axis have other gains and offsets."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    axis = rng.integers(3)
    vector[:, axis] += 10 ** rng.uniform(-4, -2) * rng.normal(size=len(vector))
    vector[:, 6 + axis] += 10 ** rng.uniform(-9, -7) * rng.normal(size=len(vector))
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _magnet_aboard(rng: Generator) -> Case:
    """Return a case with a prior since which a magnet was left near one end of the array, and a tool of iron."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    distance = norm(pier.array.positions_m - rng.normal(0, 0.5, 3), axis=1) + 0.3
    vector[:, 6:9] += (10 ** rng.uniform(-9, -7) * rng.normal(size=3))[None] / distance[:, None] ** 3
    vector[:, :3] += (10 ** rng.uniform(-5, -3.5) * rng.normal(size=3))[None] / distance[:, None] ** 3
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _cooled(rng: Generator) -> Case:
    """Return a case with a prior since which each sensor has cooled by itself, as data sheets have it."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    for each in vector:
        each += np.sqrt(ChangeRates().variances(0.0, rng.uniform(0, 25))) * rng.uniform(-1.7, 1.7, 12)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


def _remounted(rng: Generator) -> Case:
    """Return a case with a prior since which two sensors were taken off, one of them near a tool, and mounted again."""
    pier = sound(rng, 2)
    before, vector = calibrate(pier.recording, pier.array), pier.errors.to_vector()
    vector[-2:, 9:] += np.radians(10 ** rng.uniform(-1.5, 0.5)) * rng.normal(size=(len(vector[-2:]), 3))
    vector[-1, 6:9] += 10 ** rng.uniform(-8.5, -7) * rng.normal(size=3)
    return _next_day(rng, pier, before, SensorErrors.from_vector(vector))


JUDGED: dict[str, Callable[[Generator], Case]] = {
    "AHRS of another compass": _another_compass,
    "attitude that feels turns": _thrown,
    "attitude of other times": _jittering,
    "scalar beside metal": _beside_metal,
    "scalar with a dead zone": _dead_zone,
    "prior before an amplifier": _amplified,
    "prior without a magnet aboard": _magnet_aboard,
    "prior of a warmer day": _cooled,
    "prior before sensors were remounted": _remounted,
}


def _sound(rng: Generator) -> Case:
    way = rng.integers(4)
    if way < 2:
        return sound_attitude(rng)
    if way == 2:
        return sound(rng, int(rng.choice([0, 2])))
    pier = sound(rng, 2)
    return _next_day(rng, pier, calibrate(pier.recording, pier.array), pier.errors)


def answer(case: Case) -> Calibration | str:
    """Return the calibration of a case, or why it is refused."""
    try:
        return calibrate(case.recording, case.array, prior=case.prior, main_field_T=case.main_field_T)
    except (InputError, Refused) as problem:
        return str(problem)


def distance(calibration: Calibration, errors: SensorErrors) -> float:
    """Return by how many of its standard errors the worst parameter is off."""
    truth, _ = in_first_frame(errors)
    free = calibration.standard_errors > 0
    off = calibration.errors.to_vector() - truth.to_vector()
    return float(np.max(np.abs(off[free]) / calibration.standard_errors[free]))


def changed(case: Case, given: Calibration | str) -> str:
    """Return what a sound run loses: why it is refused though its readings suffice, a warning, or a channel.

    That the run itself saw too little is no loss.
    """
    if not isinstance(given, str):
        warnings = (one for one in given.warnings if "of the sphere" not in one and "record longer" not in one)
        return "; ".join([*warnings, *(note for note in given.notes if "left out" in note or "only its mean" in note)])
    if case.recording.attitude is None:
        return ""
    error = case.rotation.inv() * Rotation.from_quat(case.recording.attitude)
    size = float(np.sqrt(np.mean(error.magnitude() ** 2) / 3))
    lag = float(np.corrcoef(error.as_rotvec()[1:, 0], error.as_rotvec()[:-1, 0])[0, 1])
    size *= np.sqrt((1 + lag) / (1 - lag)) if lag > 0.5 else 1.0
    try:
        require_accurate(maximum_a_posteriori(case.recording, replace(case.array, attitude_noise=size), Known()))
    except (InputError, Refused):
        return ""
    return given


@click.command(help=__doc__)
@click.option("--half", type=click.Choice(["made", "judged"]), required=True)
@click.option("--runs", default=200, show_default=True, help="With a wrong channel, and sound ones.")
@click.option("--first-seed", default=1, show_default=True)
@click.option("--verbose", is_flag=True, help="Print every answer that is far off, and what sound runs lose.")
def main(half: str, runs: int, first_seed: int, verbose: bool) -> None:
    """Count, print a table, and keep it."""
    kinds, rows, far_of_all = MADE if half == "made" else JUDGED, [], []
    for place, (name, make) in enumerate(track(kinds.items(), description=half)):
        refused, far, warned = [], [], []
        for run in range(-(-runs // len(kinds))):
            case = make(np.random.default_rng([first_seed, len(half), place, run]))
            given = answer(case)
            refused.append(isinstance(given, str))
            warned.append(not isinstance(given, str) and bool(given.warnings))
            far.append(not isinstance(given, str) and distance(given, case.errors) > FAR)
            if verbose and far[-1]:
                print(f"{name} {run}: {distance(given, case.errors):.1f}; {given.warnings}; {given.notes}")
        far_of_all += far
        for figure, values in (("refused", refused), ("warned of", warned), ("more than 4 standard errors off", far)):
            rows.append(Row(f"{half}, {name}", figure, [float(np.mean(values))]))
    rows.append(Row(f"{half}, all", "more than 4 standard errors off", [float(np.mean(far_of_all))], most=0.0))
    lost, far = [], []
    for run in track(range(runs), description="sound"):
        case = _sound(np.random.default_rng([first_seed, len(half), 99, run]))
        given = answer(case)
        loss = changed(case, given)
        lost.append(bool(loss))
        far.append(not isinstance(given, str) and distance(given, case.errors) > FAR)
        if verbose and (loss or far[-1]):
            print(f"sound {run}: {'' if isinstance(given, str) else round(distance(given, case.errors), 1)} {loss}")
    rows.append(Row("sound", "refused, warned of or without a channel", [float(np.mean(lost))], most=0.05))
    rows.append(Row("sound", "more than 4 standard errors off", [float(np.mean(far))]))
    command = f"python benchmarks/dependent_channels.py --half {half} --runs {runs} --first-seed {first_seed}"
    show("Channels that depend on what is calibrated", command, f"dependent_channels_{half}.csv", rows)


if __name__ == "__main__":
    main()
