"""Cases of ``dependent_channels`` with an attitude, a scalar or a place that is wrong."""

from dataclasses import replace

import numpy as np
from dependent_cases import RATE_HZ, WORLD_T, Case, noisy, random_errors, sound, sound_attitude
from numpy.linalg import norm
from numpy.random import Generator
from scipy.spatial.transform import Rotation, Slerp

from tam_calibration.model.units import FloatArray


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


def raw(rng: Generator) -> Case:
    """Return a case with an AHRS of sensor 1."""
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T[:, 0])


def filtered(rng: Generator) -> Case:
    """Return a case with an AHRS of sensor 1 that averages over 0.5 to 20 s."""
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T[:, 0], filter_s=10 ** rng.uniform(-0.3, 1.3))


def late(rng: Generator) -> Case:
    """Return a case with an attitude that comes 0.05 to 0.5 s late."""
    case = sound(rng)
    size = np.radians(10 ** rng.uniform(-1.3, -0.3))
    late = delayed(noisy(rng, case.rotation, size), rng.uniform(0.05, 0.5))
    return replace(case.with_attitude(late), array=replace(case.array, attitude_noise=[size, np.inf][rng.integers(2)]))


def beside_magnet(rng: Generator) -> Case:
    """Return a case with a constant field at the scalar, which then depends on the direction of the Earth's field."""
    case = sound(rng, int(rng.choice([0, 2])))
    magnet_T = 10 ** rng.uniform(-9, -7) * rng.normal(size=3)
    field_T = case.rotation.inv().apply(WORLD_T)
    added_T = norm(field_T + magnet_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def mean(rng: Generator) -> Case:
    """Return a case with an AHRS of the mean of all sensors."""
    case = sound(rng)
    return compass(rng, case, case.recording.readings_T.mean(axis=1))


def precorrected(rng: Generator) -> Case:
    """Return a case with an AHRS that takes off horizontal biases of an earlier day."""
    case = sound(rng)
    known_T = case.errors.bias_T[0] * [1.0, 1.0, 0.0] * rng.uniform(0.7, 1.1)
    return compass(rng, case, case.recording.readings_T[:, 0] - known_T, filter_s=float(rng.choice([0.0, 1.0])))


def late_compass(rng: Generator) -> Case:
    """Return a case with an AHRS that averages and comes late."""
    case = sound(rng)
    sensor = rng.integers(case.array.sensor_count)
    readings_T = case.recording.readings_T[:, sensor]
    return compass(rng, case, readings_T, filter_s=rng.uniform(0.2, 3), delay_s=rng.uniform(0.05, 0.3))


def beside_current(rng: Generator) -> Case:
    """Return a case with the field of a load at the scalar, which is switched as the vehicle turns."""
    case = sound(rng, int(rng.choice([0, 2])))
    field_T = case.rotation.inv().apply(WORLD_T)
    is_on = heading(field_T) > rng.uniform(-1, 1)
    load_T = 10 ** rng.uniform(-8.5, -7) * rng.normal(size=3) * is_on[:, None]
    added_T = norm(field_T + load_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def wrong_place(rng: Generator) -> Case:
    """Return a case with the field of a place far away, beside a scalar and a sound attitude."""
    case = sound_attitude(rng)
    return replace(
        case, main_field_T=Rotation.from_rotvec(rng.normal(0, 0.3, 3)).apply(WORLD_T) * rng.uniform(0.8, 1.2)
    )


def circle_fitted(rng: Generator) -> Case:
    """Return a case with an AHRS that takes off the middle of the levelled readings of sensor 1 over the recording."""
    case = sound(rng, 0)
    level = Rotation.from_euler("YX", case.rotation.as_euler("ZYX")[:, 1:])
    levelled = level.apply(case.recording.readings_T[:, 0])
    middle_T = (levelled.max(axis=0) + levelled.min(axis=0)) / 2 * [1.0, 1.0, 0.0]
    return compass(rng, case, level.inv().apply(levelled - middle_T))


def field_first(rng: Generator) -> Case:
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


def gyroscope_scale(rng: Generator) -> Case:
    """Return a case with a heading whose gyroscope is wrong by up to some parts in a hundred."""
    case = sound_attitude(rng)
    yaw, pitch, roll = Rotation.from_quat(case.recording.attitude).as_euler("ZYX").T
    yaw = np.unwrap(yaw)
    yaw = yaw[0] + (yaw - yaw[0]) * (1 + 10 ** rng.uniform(-3.5, -1.5))
    return case.with_attitude(Rotation.from_euler("ZYX", np.column_stack([yaw, pitch, roll])))


def beside_iron(rng: Generator) -> Case:
    """Return a case with soft iron beside the scalar."""
    case = sound(rng, int(rng.choice([0, 2])))
    along = rng.normal(size=3)
    field_T = case.rotation.inv().apply(WORLD_T)
    induced_T = 10 ** rng.uniform(-4.5, -2.5) * (field_T @ along)[:, None] * along
    added_T = norm(field_T + induced_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def heading_error(rng: Generator) -> Case:
    """Return a case with a scalar of optical pumping, which reads otherwise on either side of its axis."""
    case = sound(rng, int(rng.choice([0, 2])))
    axis = rng.normal(size=3)
    cosine = case.rotation.inv().apply(WORLD_T) @ axis / norm(axis) / norm(WORLD_T)
    added_T = 10 ** rng.uniform(-9.3, -7.5) * np.tanh(cosine / 0.3)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def wrong_declination(rng: Generator) -> Case:
    """Return a case with the field of a place, beside an attitude that counts from another north."""
    case = sound_attitude(rng)
    turn = Rotation.from_rotvec([0.0, 0.0, rng.choice([-1, 1]) * rng.uniform(0.05, 0.6)])
    return replace(case, main_field_T=turn.apply(WORLD_T))


def another_compass(rng: Generator) -> Case:
    """Return a case with an AHRS of a magnetometer that is not calibrated."""
    case = sound(rng)
    other = random_errors(rng, 1).distort(case.rotation.inv().apply(WORLD_T))
    return compass(rng, case, other[:, 0], filter_s=float(rng.choice([0.0, 3.0])))


def thrown(rng: Generator) -> Case:
    """Return a case with an attitude that takes the acceleration of turns for gravity."""
    case = sound_attitude(rng)
    rate = np.gradient(np.unwrap(case.rotation.as_euler("ZYX")[:, 0]), 1 / RATE_HZ)
    tilt = np.radians(10 ** rng.uniform(-1, 0.7)) * rate / np.abs(rate).max()
    seen = Rotation.from_quat(case.recording.attitude) * Rotation.from_euler("X", tilt[:, None])
    return case.with_attitude(seen)


def jittering(rng: Generator) -> Case:
    """Return a case with attitudes of other times than their stamps say."""
    case = sound_attitude(rng)
    time_s = np.arange(len(case.rotation)) / RATE_HZ
    late_s = time_s - rng.uniform(0, rng.uniform(0.02, 0.5), len(time_s))
    return case.with_attitude(Slerp(time_s, case.rotation)(np.clip(late_s, 0, None)))


def beside_metal(rng: Generator) -> Case:
    """Return a case with a scalar in a housing that conducts: currents follow the change of the field."""
    case = sound(rng, int(rng.choice([0, 2])))
    field_T = case.rotation.inv().apply(WORLD_T)
    current_T = 10 ** rng.uniform(-3.5, -1.5) * np.gradient(field_T, 1 / RATE_HZ, axis=0) * rng.uniform(0.3, 1, 3)
    added_T = norm(field_T + current_T, axis=1) - norm(field_T, axis=1)
    return replace(case, recording=replace(case.recording, scalar_T=case.recording.scalar_T + added_T))


def dead_zone(rng: Generator) -> Case:
    """Return a case with a scalar that is missing near its axis, and reads too much beside that."""
    case = sound(rng, int(rng.choice([0, 2])))
    axis = rng.normal(size=3)
    cosine = np.abs(case.rotation.inv().apply(WORLD_T) @ axis) / norm(axis) / norm(WORLD_T)
    added_T = 10 ** rng.uniform(-9.3, -7.5) * np.exp((cosine - 0.8) / 0.1)
    scalar_T = np.where(cosine > 0.8, np.nan, case.recording.scalar_T + added_T)
    return replace(case, recording=replace(case.recording, scalar_T=scalar_T))
