"""A fifth set of causes outside the library: what damp, diodes, queues, rails, servos, welders and winds do."""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.disturbance import (
    ALL,
    MOVING,
    SCALAR,
    Disturbance,
    draw_direction,
    draw_sensor,
    draw_sensors,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.outside import in_a_sensor, outside, read_late
from tam_validation.blind.processes import TimeFunction, draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole
from tam_validation.blind.vehicle import carried, size_of

_FINE = 2000
"""Steps of the heat."""


def swinging_bird(rng: Generator, scene: Scene) -> Disturbance:
    """Hang the scalar on a cord in an uneven field: it swings as a pendulum, wider or less wide as the wind blows."""
    rate_hz = np.sqrt(9.81 / rng.uniform(0.5, 3)) / (2 * np.pi)
    strength = 1 + 0.4 * np.tanh(draw_wander(rng, scene.duration_s, 9)(scene.time_s))
    swing = strength * np.sin(2 * np.pi * rate_hz * scene.time_s + rng.uniform(0, 2 * np.pi))
    uneven = swing + rng.uniform(-0.3, 0.3) * swing**2
    return Disturbance("swinging_bird", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * uneven)), "nT", {})


def missed_cycles(rng: Generator, scene: Scene) -> Disturbance:
    """Let the counter of a scalar miss cycles of a faint precession now and then: each is as much field too little."""
    faint = rng.random(scene.sample_count) < 10 ** rng.uniform(-2.0, -1.2)
    missed = -1e-9 * faint * rng.geometric(0.6, scene.sample_count)
    return Disturbance("missed_cycles", (SCALAR,), (), proportional(of_scalar(scene, missed)), "nT of a cycle", {})


def warm_cable(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Lay a twisted cable beside a sensor: its heat, by the square of the recorded current, shifts the bias late."""
    return np.outer(followed(rng, scene, lambda time_s: scene.current(time_s) ** 2), rng.normal(size=3))


def thermal_tilt(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let the feet of a sensor expand unlike: it tilts as the air warms it."""
    return np.cross(np.outer(followed(rng, scene, scene.temperature), draw_direction(rng)), scene.core(sensor))


def followed(rng: Generator, scene: Scene, heating: TimeFunction) -> FloatArray:
    """Return how warm (N,) matter is that follows a heating late, of mean zero and standard deviation one."""
    lag_s = scene.duration_s * 10 ** rng.uniform(-2.0, -1.2)
    fine_s = np.linspace(-5 * lag_s, scene.duration_s, _FINE)
    warm = np.interp(scene.time_s, fine_s, low_pass(heating(fine_s), lag_s, fine_s))
    return np.asarray((warm - warm.mean()) / warm.std())


def moist_boards(rng: Generator, scene: Scene) -> Disturbance:
    """Open a dry box: damp diffuses into the boards of all sensors, and the resistors that set the gains swell.

    Source: Crank, The Mathematics of Diffusion, 2nd ed., 1975, eq. 4.18.
    """
    share, odd = scene.time_s / scene.duration_s + rng.uniform(0, 0.05), np.arange(1, 60, 2)
    damp = 1 - np.exp(-np.outer(share / rng.uniform(0.3, 1.5), odd**2)) @ (8 / (np.pi * odd) ** 2)
    swells = rng.choice([-1.0, 1.0], (scene.sensor_count, 3)) * rng.uniform(0.5, 1.5, (scene.sensor_count, 3))
    vectors = 1e-9 * damp[:, None, None] * swells * scene.readings_T / scene.intensity_T.mean()
    return Disturbance("moist_boards", (ALL,), (), proportional((vectors, 0 * scene.time_s)), "nT", {})


def shared_rail(rng: Generator, scene: Scene) -> Disturbance:
    """Let some sensors share a supply rail, which dips by the currents that null the field in all of their axes."""
    sharing = draw_sensors(rng, scene)
    drawn = np.abs(scene.readings_T[:, sharing]).sum(axis=(1, 2)) / scene.intensity_T.mean()
    change = proportional(of_sensors(scene, {one: 1e-9 * np.outer(drawn, draw_direction(rng)) for one in sharing}))
    return Disturbance("shared_rail", tuple(one + 1 for one in sharing), (), change, "nT", {})


def leaking_diode(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let a spark damage the diodes that guard an input: from then on they leak, steeply more towards one end."""
    reading_T = rng.choice([-1.0, 1.0], 3) * scene.readings_T[:, sensor]
    leak = np.exp(rng.uniform(3, 8) * (reading_T / np.abs(reading_T).max() - 1))
    after = scene.time_s > rng.uniform(0.25, 0.75) * scene.duration_s
    return np.asarray(after[:, None] * leak * rng.uniform(0.6, 1.4, 3) * rng.choice([-1.0, 1.0]))


def overload_tail(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let an output stage grow warm while it is driven beyond a limit, and shift until it has cooled down again."""
    lag_s = scene.step_s * rng.uniform(3, 15)
    fine_s = np.arange(-5 * lag_s, scene.duration_s + scene.step_s, scene.step_s)
    driven_T = rng.choice([-1.0, 1.0], 3) * scene.readings_at(fine_s)[:, sensor]
    limit_T = np.quantile(driven_T, rng.uniform(0.75, 0.9), axis=0)
    beyond = np.maximum(driven_T - limit_T, 0) / scene.intensity_T.mean()
    tails = [np.interp(scene.time_s, fine_s, low_pass(one, lag_s, fine_s)) for one in beyond.T]
    return np.asarray(np.stack(tails, axis=1) * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.6, 1.4, 3))


def draining_queue(rng: Generator, scene: Scene) -> Disturbance:
    """Stamp the readings of a sensor on arrival: at times a busy bus delays them, until its queue is empty again."""
    late = np.zeros(scene.sample_count)
    for start_s in rng.uniform(0, 0.93, int(rng.integers(4, 9))) * scene.duration_s:
        drained = (scene.time_s - start_s) / (scene.duration_s * rng.uniform(0.02, 0.07))
        late = np.maximum(late, rng.uniform(0.6, 1.4) * (1 - drained) * ((drained >= 0) & (drained < 1)))
    return read_late(scene, "draining_queue", draw_sensor(rng, scene), late)


def hunting_clock(rng: Generator, scene: Scene) -> Disturbance:
    """Let the servo that keeps a sensor's clock by the network be tuned too sharp: it hunts about the right time."""
    strength = 1 + 0.4 * np.tanh(draw_wander(rng, scene.duration_s, 9)(scene.time_s))
    cycles = rng.uniform(12, 40) * scene.time_s / scene.duration_s
    late = strength * np.sin(2 * np.pi * cycles + rng.uniform(0, 2 * np.pi))
    return read_late(scene, "hunting_clock", draw_sensor(rng, scene), late)


def walking_operator(rng: Generator, scene: Scene) -> Disturbance:
    """Let who turns the array walk around with it, upright, with iron in the pockets: it yaws along but never tilts."""
    yaw = scene.motion.angles(scene.time_s)[:, 0]
    return from_beside(rng, scene, "walking_operator", about("z", -yaw) @ scene.to_world, np.ones(len(yaw)))


def arc_welder(rng: Generator, scene: Scene) -> Disturbance:
    """Weld aluminium near the array, which takes an alternating arc: its restless current is noise while it burns."""
    arcs = rng.uniform(0, 0.95, int(rng.integers(4, 10))) * scene.duration_s
    since = (scene.time_s[:, None] - arcs) / (scene.duration_s * rng.uniform(0.02, 0.08, len(arcs)))
    current = rng.normal(size=scene.sample_count) * ((since >= 0) & (since < 1)).any(axis=1)
    return from_beside(rng, scene, "arc_welder", scene.to_world, current)


def from_beside(rng: Generator, scene: Scene, effect: str, turned: FloatArray, size: FloatArray) -> Disturbance:
    """Return what a dipole of some size (N,) does, at rest in a frame in which the array turns (N, 3, 3)."""
    distance_m = rng.uniform(0.8, 3)
    at_m = np.einsum("nij,kj->nki", turned, np.vstack([scene.positions_m, np.zeros(3)]))
    field = dipole(draw_direction(rng), at_m - distance_m * draw_direction(rng))
    extra = np.einsum("n,nji,nkj->nki", size, turned, field)
    change = carried(scene, 1e-9 * extra / size_of(extra))
    return Disturbance(effect, (ALL,), (), change, "nT", {"distance_m": distance_m})


FIFTH = {
    "swinging_bird": outside(swinging_bird, scalar_needed=True, named="periodic_interference"),
    "missed_cycles": outside(missed_cycles, scalar_needed=True, named="outliers"),
    "warm_cable": in_a_sensor(warm_cable, 0.4, channel="current"),
    "thermal_tilt": in_a_sensor(thermal_tilt, channel="temperature"),
    "moist_boards": outside(moist_boards),
    "shared_rail": outside(shared_rail),
    "leaking_diode": in_a_sensor(leaking_diode, 0.8),
    "overload_tail": in_a_sensor(overload_tail, 0.7),
    "draining_queue": outside(draining_queue, motions=MOVING),
    "hunting_clock": outside(hunting_clock, motions=MOVING),
    "walking_operator": outside(walking_operator, channel="attitude"),
    "arc_welder": outside(arc_welder),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
