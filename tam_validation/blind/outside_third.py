"""A third set of causes outside the library: what boats, cables, capacitors, seawater and trackers do."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    named,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, read_late, turning_rate
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_FINE = 2
"""Steps of a loop that is too slow, within one of the recording."""

_LEAST_SPEED = 0.02
"""Least speed of the loop, as a share of the fastest change of the field: it never stands still."""


def flux_jumps(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the loop of a superconducting sensor lose count of flux quanta, most likely while the field changes fast."""
    speed = np.abs(np.gradient(scene.core(sensor), axis=0))
    course = np.zeros((scene.sample_count, 3))
    for axis in range(3):
        chances = (speed[:, axis] + speed[:, axis].mean()) / (2 * speed[:, axis].sum())
        jumps = rng.choice(scene.sample_count, int(rng.integers(5, 14)), replace=False, p=chances / chances.sum())
        course[jumps, axis] = rng.choice([-2.0, -1.0, -1.0, 1.0, 1.0, 2.0], len(jumps))
    return np.cumsum(course, axis=0)


def passing_boat(rng: Generator, scene: Scene) -> Disturbance:
    """Let a boat of steel go by at some metres; the sensor nearest to it sees a little more of it than the others."""
    course, abeam = draw_direction(rng) * np.array([1, 1, 0]), draw_direction(rng)
    course /= norm(course)
    abeam -= (abeam @ course) * course
    nearest_m = rng.uniform(4, 12)
    run = (scene.time_s / scene.duration_s - rng.uniform(0.25, 0.75)) / rng.uniform(0.05, 0.2)
    boat_m = nearest_m * (abeam / norm(abeam) + np.outer(run, course))
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    world = dipole(draw_direction(rng), at_m - boat_m[:, None])
    body = np.einsum("nji,nkj->nki", scene.to_world, world)
    parameters = {"nearest_m": nearest_m}
    return Disturbance("passing_boat", (ALL,), (), carried(scene, 1e-9 * body / size_of(body)), "nT", parameters)


def lost_lock(rng: Generator, scene: Scene) -> Disturbance:
    """Let a tracking scalar lose its resonance now and then, and creep away from it until it is locked again."""
    creep = np.zeros(scene.sample_count)
    for start_s in rng.uniform(0, 0.95, int(rng.integers(5, 12))) * scene.duration_s:
        since_s, lasting_s = scene.time_s - start_s, scene.duration_s * rng.uniform(0.01, 0.05)
        away = 1 - np.exp(-since_s / (lasting_s * rng.uniform(0.3, 1.0)))
        creep = np.where((since_s > 0) & (since_s < lasting_s), rng.uniform(0.7, 1.3) * away, creep)
    drifting = rng.choice([-1.0, 1.0]) * 1e-9 * creep
    return Disturbance("lost_lock", (SCALAR,), (), proportional(of_scalar(scene, drifting)), "nT", {})


def wet_connector(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a wave wet a plug from time to time: a part of the signal leaks away until the water is gone."""
    wet = np.zeros(scene.sample_count)
    for wave_s in rng.uniform(-0.02, 0.9, int(rng.integers(4, 9))) * scene.duration_s:
        since = np.maximum(scene.time_s - wave_s, 0) / (scene.duration_s * rng.uniform(0.02, 0.08))
        wet = np.maximum(wet, rng.uniform(0.5, 1.0) * np.exp(-since) * (scene.time_s >= wave_s))
    lost = np.outer(wet, rng.uniform(0.6, 1.4, 3))
    return np.asarray(-lost * scene.readings_T[:, sensor] / scene.intensity_T.mean())


def strumming_arm(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the water that flows past an arm shake it at one rate, now more, now less: its sensor turns to and fro."""
    strength = 1 + 0.4 * np.tanh(draw_wander(rng, scene.duration_s, 9)(scene.time_s))
    cycles = rng.uniform(0.06, 0.44) * scene.time_s / scene.step_s
    angle = strength * np.sin(2 * np.pi * cycles + rng.uniform(0, 2 * np.pi))
    bending = np.cross(scene.positions_m[sensor], draw_direction(rng))
    return np.cross(np.outer(angle, bending / norm(bending)), scene.core(sensor))


def capacitor_lag(rng: Generator, scene: Scene) -> Disturbance:
    """Let a filter's capacitor change with the temperature; its delay was corrected for the mean one only."""
    air_C = scene.temperature(scene.time_s)
    late = rng.choice([-1.0, 1.0]) * (air_C - air_C.mean()) / air_C.std()
    return read_late(scene, "capacitor_lag", draw_sensor(rng, scene), late)


def slew_limit(rng: Generator, scene: Scene) -> Disturbance:
    """Let a feedback loop follow the field no faster than so much in a time: it falls behind, and catches up."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    fine_s = np.arange(0, scene.duration_s + scene.step_s, scene.step_s / _FINE)
    wanted_T = scene.readings_at(fine_s)[:, sensor]
    fastest_T = float((mask * np.abs(np.diff(wanted_T, axis=0))).max())

    def change(amplitude: float, _seen: object) -> Signal:
        most_T = max(fastest_T - amplitude / _FINE, _LEAST_SPEED * fastest_T)
        followed = np.stack([_followed(one, most_T) for one in wanted_T.T], axis=1)
        sampled = np.stack([np.interp(scene.time_s, fine_s, one) for one in (followed - wanted_T).T], axis=1)
        return of_sensors(scene, {sensor: mask * sampled})

    return Disturbance("slew_limit", (sensor + 1,), named(mask), change, "T a sample too slow", {})


def _followed(wanted: FloatArray, most: float) -> FloatArray:
    """Return what follows a course (n,) by no more than so much a step."""
    now, course = float(wanted[0]), []
    for value in wanted.tolist():
        now += min(max(value - now, -most), most)
        course.append(now)
    return np.array(course)


def dielectric_absorption(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let an integrator's capacitor soak up a part of each voltage and give it back over many samples."""
    fine_s = np.arange(0, scene.duration_s + scene.step_s, scene.step_s)
    soaking_s = scene.step_s * 10 ** rng.uniform(0.9, 1.8)
    soaked = np.stack([low_pass(one, soaking_s, fine_s) for one in scene.readings_at(fine_s)[:, sensor].T], axis=1)
    kept = np.stack([np.interp(scene.time_s, fine_s, one) for one in soaked.T], axis=1)
    return np.asarray(rng.uniform(0.6, 1.4, 3) * kept / scene.intensity_T.mean())


def residue_gain(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a converter in two stages amplify what the first one leaves by too much: a saw over the reading."""
    reading_T = scene.readings_T[:, sensor]
    stage_T = 2 * np.abs(reading_T).max() * rng.uniform(1.0, 1.3) / rng.integers(6, 24)
    return np.asarray((reading_T / stage_T + rng.uniform(0, 1, 3)) % 1 - 0.5)


def degaussing_coil(rng: Generator, scene: Scene) -> Disturbance:
    """Carry the array on a ship with a coil against its magnetisation, whose current is set from the heading."""
    heading = np.arctan2(scene.to_world[:, 1, 0], scene.to_world[:, 0, 0])
    place_m = float(np.abs(scene.positions_m).max()) * rng.uniform(4, 10) * draw_direction(rng)
    coil = dipole(draw_direction(rng), np.vstack([scene.positions_m, np.zeros(3)]) - place_m)
    extra = np.cos(heading - rng.uniform(0, 2 * np.pi))[:, None, None] * coil
    parameters = {"distance_m": float(norm(place_m))}
    return Disturbance("degaussing_coil", (ALL,), (), carried(scene, 1e-9 * extra / size_of(extra)), "nT", parameters)


def triboelectric_cable(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let the sheath of a cable rub: the faster the array turns about one of its directions, the louder it crackles."""
    bending = np.abs(turning_rate(scene) @ draw_direction(rng))
    loud = (bending / np.quantile(bending, 0.95)) ** rng.uniform(1, 2)
    return np.asarray(rng.normal(size=(scene.sample_count, 3)) * loud[:, None])


def torn_bytes(rng: Generator, scene: Scene) -> Disturbance:
    """Read the high bytes of a register a moment before the lowest one: a carry in between makes an error of a byte."""
    sensor, byte_T = draw_sensor(rng, scene), scene.vector_noise_T * rng.uniform(16, 40)

    def change(amplitude: float, seen: Signal) -> Signal:
        before = scene.readings_at(scene.time_s - amplitude)[:, sensor] - scene.readings_T[:, sensor]
        reading = seen[0][:, sensor]
        carried_over = np.floor((reading + before) / byte_T) - np.floor(reading / byte_T)
        return of_sensors(scene, {sensor: byte_T * carried_over})

    parameters = {"byte_nT": 1e9 * byte_T}
    return Disturbance("torn_bytes", (sensor + 1,), (), change, "s between the bytes", parameters, after_noise=True)


THIRD = {
    "flux_jumps": in_a_sensor(flux_jumps, 0.8),
    "passing_boat": outside(passing_boat),
    "lost_lock": outside(lost_lock, scalar_needed=True),
    "wet_connector": in_a_sensor(wet_connector, 0.5),
    "strumming_arm": in_a_sensor(strumming_arm),
    "capacitor_lag": outside(capacitor_lag, channel="temperature", motions=MOVING),
    "slew_limit": outside(slew_limit, motions=MOVING),
    "dielectric_absorption": in_a_sensor(dielectric_absorption, 0.3, motions=MOVING),
    "residue_gain": in_a_sensor(residue_gain, 0.6),
    "degaussing_coil": outside(degaussing_coil, channel="attitude"),
    "triboelectric_cable": in_a_sensor(triboelectric_cable, 0.4, motions=MOVING),
    "torn_bytes": outside(torn_bytes, motions=MOVING, named="outliers"),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
