"""A twelfth set of causes outside the library: what antennas, arms, booms, gyros, joints, lamps and legs do."""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    Signal,
    draw_direction,
    draw_sensors,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, turning_rate
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of


def turning_antenna(rng: Generator, scene: Scene) -> Disturbance:
    """Turn the array beside the mast of an antenna that goes round and round: its steel is magnetised lengthwise."""
    near_m, heading, turn_s = rng.uniform(2, 5), rng.uniform(0, 2 * np.pi), scene.step_s * rng.uniform(8, 40)
    antenna_m = near_m * np.array([np.cos(heading), np.sin(heading), rng.uniform(0.2, 1)])
    slip = rng.uniform(0, 0.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    angle = 2 * np.pi * scene.time_s / turn_s + slip
    moment = np.stack([np.cos(angle), np.sin(angle), np.zeros(scene.sample_count)], axis=1)
    at_m = np.einsum("nij,kj->nki", scene.to_world, np.vstack([scene.positions_m, np.zeros(3)]))
    extra = np.einsum("nji,nkj->nki", scene.to_world, _of_moments(moment, at_m - antenna_m))
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("turning_antenna", (ALL,), (), change, "nT", {"turn_s": turn_s, "distance_m": near_m})


def _of_moments(moment: FloatArray, away_m: FloatArray) -> FloatArray:
    """Return the field (N, P, 3) of a moment (N, 3) that changes, at distances (N, P, 3) from it."""
    return np.asarray(np.einsum("nm,mnpi->npi", moment, np.stack([dipole(one, away_m) for one in np.eye(3)])))


def working_arm(rng: Generator, scene: Scene) -> Disturbance:
    """Let a vehicle's arm reach for one thing or another: the magnets of its motors rest at other places each time."""
    moves, stations = int(rng.integers(4, 10)), int(rng.integers(3, 6))
    distance_m, base = float(np.abs(scene.positions_m).max()) * rng.uniform(4, 9), draw_direction(rng)
    poses = [np.append(base + 0.6 * draw_direction(rng), draw_direction(rng)) for _ in range(stations)]
    stops = (int(rng.integers(stations)) + np.cumsum(np.append(0, rng.integers(1, stations, moves)))) % stations
    leaves = np.sort(rng.uniform(0.03, 0.95, moves))
    arrives = np.minimum(leaves + 0.01, np.append(leaves[1:], 1.0))
    corners, rests = np.stack([leaves, arrives], axis=1).ravel(), np.repeat(np.array(poses)[stops], 2, axis=0)[1:-1]
    pose = np.stack([np.interp(scene.time_s / scene.duration_s, corners, one) for one in rests.T], axis=1)
    away_m = np.vstack([scene.positions_m, np.zeros(3)]) - distance_m * pose[:, None, :3]
    extra = _of_moments(pose[:, 3:], away_m)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance("working_arm", (ALL,), (), change, "nT", {"moves": moves, "stations": stations})


def directional_gyro(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Spin a magnetised rotor in gimbals near a sensor: it keeps its direction in the world, but for a slow drift."""
    heading = rng.uniform(0, 2 * np.pi) + rng.uniform(-0.5, 0.5) * scene.time_s / scene.duration_s
    up = rng.uniform(-0.8, 0.8)
    level = (1 - up**2) ** 0.5
    axle = np.stack([level * np.cos(heading), level * np.sin(heading), np.full(scene.sample_count, up)], axis=1)
    moment, toward = np.einsum("nji,nj->ni", scene.to_world, axle), draw_direction(rng)
    return np.asarray((3 * np.outer(moment @ toward, toward) - moment) @ scene.response[sensor].T)


def stowed_leg(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Fold a leg of soft steel once: from then on the Earth's field magnetises it along another line, elsewhere."""
    folded = scene.time_s > scene.duration_s * rng.uniform(0.2, 0.8)
    fields = []
    for _ in range(2):
        along, toward = draw_direction(rng), draw_direction(rng)
        fields.append(np.outer(scene.field_T @ along, 3 * (along @ toward) * toward - along))
    extra = folded[:, None] * (fields[1] - fields[0]) / scene.intensity_T.mean()
    return np.asarray(extra @ scene.response[sensor].T)


def aliased_ripple(rng: Generator, scene: Scene) -> Disturbance:
    """Feed some bridges by a converter whose ripple is nearly a multiple of the sampling: all they read swings."""
    fed, swing_s = draw_sensors(rng, scene), scene.step_s * rng.uniform(4, 40)
    slip = rng.uniform(0, 0.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    ripple = np.sin(2 * np.pi * scene.time_s / swing_s + slip + rng.uniform(0, 2 * np.pi))
    readings = 1e-9 * ripple[:, None, None] * scene.readings_T / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: readings[:, one] for one in fed}))
    return Disturbance("aliased_ripple", tuple(one + 1 for one in fed), (), change, "nT", {"swing_s": swing_s})


def throttled_processor(rng: Generator, scene: Scene) -> Disturbance:
    """Slow a processor down while a load pulls its supply below a limit: what it filters then comes out late."""
    served, load_A = draw_sensors(rng, scene), scene.current(scene.time_s)
    slow = load_A > np.quantile(load_A, rng.uniform(0.4, 0.75))

    def change(amplitude: float, _seen: object) -> Signal:
        waited = scene.readings_at(scene.time_s - amplitude * slow) - scene.readings_T
        return of_sensors(scene, {one: waited[:, one] for one in served})

    return Disturbance("throttled_processor", tuple(one + 1 for one in served), (), change, "s", {})


def soaking_capacitor(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Smooth an input by a capacitor whose insulation soaks up charge: it gives back some of what was read before."""
    lags_s = scene.step_s * 10 ** rng.uniform(0, 1.7, 3)
    fine_s = np.arange(-5 * lags_s.max(), scene.duration_s + scene.step_s, scene.step_s / 3)
    soaked = [np.mean([low_pass(one, lag, fine_s) for lag in lags_s], axis=0) for one in _read(scene, sensor, fine_s).T]
    given = np.stack([np.interp(scene.time_s, fine_s, one) for one in soaked], axis=1)
    return np.asarray(given - _read(scene, sensor, scene.time_s))


def _read(scene: Scene, sensor: int, time_s: FloatArray) -> FloatArray:
    """Return what a sensor reads (n, 3) at any time, as a share of the intensity."""
    return np.asarray(scene.readings_at(time_s)[:, sensor] / scene.intensity_T.mean())


def leaking_diode(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Protect an input by a diode: near one end it leaks exponentially, and twice as much for each ten degrees."""
    end = rng.choice([-1.0, 1.0], 3)
    toward = end * _read(scene, sensor, scene.time_s)
    air_C = scene.temperature(scene.time_s)[:, None]
    leak = np.exp((toward - toward.max(axis=0)) / rng.uniform(0.1, 0.3)) * 2 ** ((air_C - air_C.max()) / 10)
    return np.asarray(-end * leak)


def thermoelectric_joint(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Join two metals by a thin and by a thick screw: a current flows while the thick one is not yet as warm."""
    lag_s = scene.duration_s * 10 ** rng.uniform(-2.2, -1.4)
    fine_s = np.linspace(-5 * lag_s, scene.duration_s, 2000)
    air_C = scene.temperature(fine_s)
    current = np.interp(scene.time_s, fine_s, air_C - low_pass(air_C, lag_s, fine_s))
    return np.outer(current / current.std(), draw_direction(rng))


def warming_lamp(rng: Generator, scene: Scene) -> Disturbance:
    """Pump a scalar by a lamp that is too bright until it is warm: its light shifts the line along its beam."""
    bright = np.exp(-scene.time_s / scene.duration_s / rng.uniform(0.1, 0.4)) + rng.uniform(0, 0.2)
    along = scene.field_T @ draw_direction(rng) / scene.intensity_T
    change = proportional(of_scalar(scene, 1e-9 * bright * along))
    return Disturbance("warming_lamp", (SCALAR,), (), change, "nT", {})


def shaken_boom(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Hold a sensor out on a boom in gusts: it shakes with the square of the wind, and turns in the field."""
    wind = 1 + 0.8 * np.tanh(draw_wander(rng, scene.duration_s, 9)(scene.time_s))
    return np.asarray(np.cross(wind[:, None] ** 2 * rng.normal(size=(scene.sample_count, 3)), scene.core(sensor)))


def static_discharge(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Charge a plastic frame by its motion through the air: each time that it is full, a spark hits one reading."""
    charge = np.cumsum(np.linalg.norm(turning_rate(scene), axis=1) * np.gradient(scene.time_s))
    sparks = max(5, int(scene.sample_count * 10 ** rng.uniform(-2.4, -1.7)))
    full = np.cumsum(rng.uniform(0.6, 1.4, 2 * sparks)) * charge[-1] / sparks
    hit = np.diff(np.searchsorted(full, charge), prepend=0) > 0
    return np.outer(hit * rng.uniform(0.6, 1.4, scene.sample_count), rng.choice([-1, 1], 3) * rng.uniform(0.5, 1.5, 3))


TWELFTH = {
    "turning_antenna": outside(turning_antenna, channel="attitude", named="periodic_interference"),
    "working_arm": outside(working_arm, named="bias_jump"),
    "directional_gyro": in_a_sensor(directional_gyro, channel="attitude"),
    "stowed_leg": in_a_sensor(stowed_leg),
    "aliased_ripple": outside(aliased_ripple),
    "throttled_processor": outside(throttled_processor, motions=MOVING, channel="current"),
    "soaking_capacitor": in_a_sensor(soaking_capacitor, 0.4, motions=MOVING, named="eddy_current"),
    "leaking_diode": in_a_sensor(leaking_diode, 0.6, channel="temperature", named="nonlinearity"),
    "thermoelectric_joint": in_a_sensor(thermoelectric_joint, channel="temperature", named="temperature_drift"),
    "warming_lamp": outside(warming_lamp, scalar_needed=True, most_nT=100.0, named="scalar_heading_error"),
    "shaken_boom": in_a_sensor(shaken_boom, named="noise_excess"),
    "static_discharge": in_a_sensor(static_discharge, 0.5, motions=MOVING, named="outliers"),
}
"""The causes by their names; of those in a sensor the chance of one axis only. Light shifts a line by tens of nT."""
