"""Causes outside the library, in one sensor or the scalar. Rules of a diagnosis may be tuned on these.

One that has had a name in the library since states it: that name is as right as none.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    MOVING,
    SCALAR,
    SEVERAL,
    Disturbance,
    Draw,
    Entry,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.material import low_pass
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene

_Course = Callable[[Generator, Scene, int], FloatArray]
"""Draws what is added to a sensor (N, 3), of the size of one."""

_LEAST_FALLS, _TRIES = 4, 50
"""Least number of falls (with fewer it is a bias jump), and attempts to draw so many."""


def random_walk_bias(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a bias walk at random, restlessly."""
    walk = np.cumsum(rng.normal(size=(scene.sample_count, 3)) * np.gradient(scene.time_s)[:, None] ** 0.5, axis=0)
    return np.asarray(walk / walk.std())


def pressure_chirp(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let an axis follow a depth nobody recorded: down and up, ever faster."""
    share, cycles = scene.time_s / scene.duration_s, rng.uniform(3, 7)
    depth = np.sin(2 * np.pi * (0.3 * share + (cycles - 0.3) * share**2 / 2) + rng.uniform(0, 2 * np.pi))
    return np.outer(depth + 0.3 * depth**2, rng.uniform(0.5, 1.5, 3))


def cycling_bias(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a thermostat nobody recorded switch a heater, each time after another while; the bias follows."""
    half_s = scene.duration_s / rng.uniform(5, 12)
    edges_s = np.cumsum(half_s * rng.uniform(0.6, 1.4, 40)) - half_s * rng.random()
    heated = np.searchsorted(edges_s, scene.time_s) % 2.0
    return np.outer(low_pass(heated, half_s * rng.uniform(0.3, 1.5), scene.time_s), rng.normal(size=3))


def relaxing_tail(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Kick the iron beside a sensor a few times: what each kick magnetised fades with the logarithm of time."""
    course = np.zeros((scene.sample_count, 3))
    for kick_s in rng.uniform(-0.05, 0.9, int(rng.integers(5, 9))) * scene.duration_s:
        since = np.maximum(scene.time_s - kick_s, 0) / (scene.duration_s * 10 ** rng.uniform(-3, -2))
        left = np.maximum(1 - 0.45 * np.log10(1 + since), 0) * (scene.time_s >= kick_s)
        course += np.outer(left, rng.uniform(0.5, 1.5) * draw_direction(rng))
    return course


def burst_noise(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a contact or a semiconductor flip between two offsets, at any time."""
    stays_s = rng.exponential(scene.duration_s / np.tile(rng.uniform(15, 60, 2), 200))
    return np.outer(np.searchsorted(np.cumsum(stays_s), scene.time_s) % 2.0, rng.normal(size=3))


def gain_wander(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Gains that depend on the time of day."""
    wander = np.stack([draw_wander(rng, scene.duration_s, 7)(scene.time_s) for _ in range(3)], axis=1)
    return wander * scene.core(sensor)


def mount_slip(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Turn a sensor in its mount by a little, and later by a little more."""
    times_s = np.sort(rng.uniform(0.2, 0.8, 2)) * scene.duration_s
    angles = rng.normal(size=(3, 3))
    angles[0] = 0
    return np.cross(angles[np.searchsorted(times_s, scene.time_s)], scene.core(sensor))


def cross_field(rng: Generator, scene: Scene, sensor: int) -> FloatArray:
    """Let an axis answer to the product of the fields along the two others."""
    core = scene.core(sensor)
    return rng.uniform(0.6, 1.4, 3) * core[:, [1, 2, 0]] * core[:, [2, 0, 1]] * (1 + 0.5 * core)


def compass_needle(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Mount a compass beside a sensor: its needle points along the field in the plane of its card."""
    pivot, away = draw_direction(rng), draw_direction(rng)
    in_plane = scene.field_T - np.outer(scene.field_T @ pivot, pivot)
    needle = in_plane / norm(in_plane, axis=1, keepdims=True)
    return np.asarray(3 * np.outer(needle @ away, away) - needle)


def orientation_noise(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a core be quiet while the field magnetises it along one direction, and noisy the more it lies across."""
    across = 1 - (scene.field_T @ draw_direction(rng) / scene.intensity_T) ** 2
    loud = (across / np.quantile(across, 0.95)) ** rng.uniform(2, 4)
    return np.asarray(rng.normal(size=(scene.sample_count, 3)) * loud[:, None])


def centrifugal_bias(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Strain a core by the turning: its offset goes with the square of the rate and with products of its components."""
    rate, arm = turning_rate(scene), draw_direction(rng)
    strain = (rate @ arm)[:, None] * rate - (rate**2).sum(axis=1, keepdims=True) * arm
    return np.asarray(strain / strain.std() @ rng.normal(size=(3, 3)))


def sunlit_side(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let the sun warm the side of a housing that is turned to it; the bias follows its warmth, slowly."""
    sun, side = draw_direction(rng), draw_direction(rng)
    lit = np.maximum(np.einsum("nij,j,i->n", scene.to_world, side, [*sun[:2], abs(sun[2])]), 0)
    return np.outer(low_pass(lit, scene.duration_s * rng.uniform(0.01, 0.06), scene.time_s), rng.normal(size=3))


def stiction(rng: Generator, scene: Scene, _sensor: int) -> FloatArray:
    """Let a loose part in a sensor fall from side to side as it is turned, late and never twice alike."""
    for _ in range(_TRIES):
        sides = _fallen(rng, scene.to_world[:, 2] @ draw_direction(rng))
        if np.sum(np.diff(np.sign(sides)) != 0) >= _LEAST_FALLS:
            break
    return np.outer(sides, draw_direction(rng))


def _fallen(rng: Generator, tilt: FloatArray) -> FloatArray:
    """Return on which side a loose part lies, and how far from the middle."""
    side, sides = 1.0, []
    for value in tilt.tolist():
        if value * side < -rng.uniform(0.05, 0.9):
            side = -side
        sides.append(side * rng.uniform(0.7, 1.0))
    return np.array(sides)


def polled_sensor(rng: Generator, scene: Scene) -> Disturbance:
    """Poll a sensor that runs at a rate of its own: the age of its latest reading grows to a period, then is none."""
    sensor = draw_sensor(rng, scene)
    slip = rng.uniform(0, 0.4) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    late = rng.choice([-1.0, 1.0]) * ((rng.uniform(8, 40) * scene.time_s / scene.duration_s + slip) % 1 - 0.5) * 12**0.5

    def change(amplitude: float, _seen: object) -> Signal:
        read = scene.readings_at(scene.time_s - amplitude * late)[:, sensor]
        return of_sensors(scene, {sensor: read - scene.readings_T[:, sensor]})

    return Disturbance("polled_sensor", (sensor + 1,), (), change, "s", {})


def gyroscopic_shift(rng: Generator, scene: Scene) -> Disturbance:
    """Add the array's rotation about the field to the precession that a scalar magnetometer counts."""
    about_field = (turning_rate(scene) * scene.field_T).sum(axis=1) / scene.intensity_T
    blur = rng.uniform(0, 0.3) * np.abs(about_field)
    error = rng.choice([-1.0, 1.0]) * (about_field + blur) / about_field.std()
    return Disturbance("gyroscopic_shift", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * error)), "nT", {})


def turning_rate(scene: Scene) -> FloatArray:
    """Return the array's rotation rate (N, 3) in its frame [rad/s]."""
    return scene.motion.turning_rate(scene.time_s, scene.step_s / 50)


def in_a_sensor(course: _Course, one_axis: float = 0.0, **more: Any) -> Entry:
    """Return the entry of a cause that adds a course to one sensor, by some chance to one of its axes."""

    def draw(rng: Generator, scene: Scene) -> Disturbance:
        sensor, mask = draw_sensor(rng, scene), draw_axes(rng, one_axis) if one_axis else np.ones(3)
        return in_one_sensor(scene, course.__name__, sensor, mask, 1e-9 * mask * course(rng, scene, sensor), {})

    return outside(draw, **more)


def outside(draw: Draw, **more: Any) -> Entry:
    """Return the entry of a cause outside the library."""
    return Entry(draw, "outside", sensor_counts=SEVERAL, **more)


OUTSIDE = {
    "random_walk_bias": in_a_sensor(random_walk_bias),
    "pressure_chirp": in_a_sensor(pressure_chirp, 0.6),
    "cycling_bias": in_a_sensor(cycling_bias, 0.5),
    "relaxing_tail": in_a_sensor(relaxing_tail),
    "burst_noise": in_a_sensor(burst_noise, 0.7),
    "gain_wander": in_a_sensor(gain_wander, 0.5),
    "mount_slip": in_a_sensor(mount_slip, named="scale_step"),
    "cross_field": in_a_sensor(cross_field, 0.5),
    "compass_needle": in_a_sensor(compass_needle),
    "orientation_noise": in_a_sensor(orientation_noise, 0.4),
    "centrifugal_bias": in_a_sensor(centrifugal_bias, 0.4, motions=MOVING),
    "sunlit_side": in_a_sensor(sunlit_side, 0.3),
    "stiction": in_a_sensor(stiction),
    "polled_sensor": outside(polled_sensor, motions=MOVING),
    "gyroscopic_shift": outside(gyroscopic_shift, motions=MOVING, scalar_needed=True),
}
"""The causes by their names; of those in a sensor the chance that it is one axis only."""
