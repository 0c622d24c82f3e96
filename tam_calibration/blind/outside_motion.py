"""Causes outside the library, the open half: those that follow the motion."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.blind.disturbance import (
    SCALAR,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    of_scalar,
    proportional,
)
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray


def swinging_magnet(rng: Generator, scene: Scene) -> Disturbance:
    """Hang a magnet on a cable beside a sensor: it swings after the vertical, late, beyond it and back."""
    sensor = draw_sensor(rng, scene)
    down = -scene.to_world[:, 2, :]
    period = rng.uniform(8, 25)
    hanging = _swung(down, 2 * np.pi / period, rng.uniform(0.05, 0.3))
    hanging /= norm(hanging, axis=1, keepdims=True)
    # In lengths of the cable: the sensor is out of the magnet's reach.
    away = draw_direction(rng) * rng.uniform(1.5, 2.5) - hanging
    distance = norm(away, axis=1, keepdims=True)
    unit = away / distance
    moment = hanging if rng.random() < 0.5 else np.tile(draw_direction(rng), (len(down), 1))
    dipole = (3 * unit * (unit * moment).sum(axis=1, keepdims=True) - moment) / distance**3
    change = 1e-9 * dipole / norm(dipole - dipole.mean(axis=0), axis=1).max()
    return in_one_sensor(scene, "swinging_magnet", sensor, np.ones(3), change, {"period_samples": period})


def _swung(drive: FloatArray, turn: float, damping: float) -> FloatArray:
    """Follow a path (N, 3) as a damped oscillator does, its phase turning by so much in a sample."""
    fine = 10
    place, speed, path = drive[0].copy(), np.zeros(3), []
    for target in drive:
        for _ in range(fine):
            speed += (turn / fine) * (target - place - 2 * damping * speed)
            place = place + (turn / fine) * speed
        path.append(place)
    return np.array(path)


def orientation_noise(rng: Generator, scene: Scene) -> Disturbance:
    """Let a core be quiet while the field magnetises it along one direction, and noisy the more it lies across."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    axis = draw_direction(rng)
    across = 1 - (scene.field_T @ axis / scene.intensity_T) ** 2
    loud = (across / np.quantile(across, 0.95)) ** rng.uniform(2, 4)
    noise = rng.normal(size=(scene.sample_count, 3)) * loud[:, None]
    return in_one_sensor(scene, "orientation_noise", sensor, mask, 1e-9 * mask * noise, {"axis": numbers(axis)})


def centrifugal_bias(rng: Generator, scene: Scene) -> Disturbance:
    """Strain a core by the turning: its offset goes with the square of the rate and with products of its components."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    arm = draw_direction(rng)
    strain = (rate @ arm)[:, None] * rate - (rate**2).sum(axis=1, keepdims=True) * arm
    strain = strain / strain.std()
    change = 1e-9 * mask * (strain @ rng.normal(size=(3, 3)))
    return in_one_sensor(scene, "centrifugal_bias", sensor, mask, change, {"arm": numbers(arm)})


def gyroscopic_shift(rng: Generator, scene: Scene) -> Disturbance:
    """Add the array's rotation about the field to the precession that a scalar magnetometer counts."""
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    about_field = (rate * scene.field_T).sum(axis=1) / scene.intensity_T
    blur = rng.uniform(0, 0.3) * np.abs(about_field)
    error = rng.choice([-1.0, 1.0]) * (about_field + blur) / about_field.std()
    return Disturbance("gyroscopic_shift", (SCALAR,), (), proportional(of_scalar(scene, 1e-9 * error)), "nT", {})


def coil_self_heating(rng: Generator, scene: Scene) -> Disturbance:
    """Let the current that compensates the field heat each core, which cools slowly; its offset follows the heat."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    heat = scene.core(sensor) ** 2
    keep = np.exp(-1 / (scene.sample_count * rng.uniform(0.02, 0.08)))
    warm, course = heat.mean(axis=0), []
    for value in heat:
        warm = keep * warm + (1 - keep) * value
        course.append(warm)
    rows = np.array(course)
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * (rows - rows.mean(axis=0)) / rows.std(axis=0)
    return in_one_sensor(scene, "coil_self_heating", sensor, mask, change, {"keep": float(keep)})


def sunlit_side(rng: Generator, scene: Scene) -> Disturbance:
    """Let the sun warm the side of a housing that is turned to it; the bias follows its warmth, slowly."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    sun, side = draw_direction(rng), draw_direction(rng)
    sun[2] = abs(sun[2])
    lit = np.maximum(np.einsum("nij,j,i->n", scene.to_world, side, sun), 0)
    keep = np.exp(-1 / (scene.sample_count * rng.uniform(0.01, 0.06)))
    warm, course = float(lit.mean()), []
    for value in lit.tolist():
        warm = keep * warm + (1 - keep) * value
        course.append(warm)
    change = 1e-9 * np.outer(course - np.mean(course), mask * rng.normal(size=3)) / np.std(course)
    return in_one_sensor(scene, "sunlit_side", sensor, mask, change, {"side": numbers(side)})
