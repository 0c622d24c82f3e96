"""Causes outside the library, the open half: in the instrument, from what senses the field to its clock and program."""

import numpy as np
from numpy.random import Generator

from tam_calibration.blind.disturbance import (
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_calibration.blind.processes import draw_wander
from tam_calibration.blind.scene import Scene


def fading_film(rng: Generator, scene: Scene) -> Disturbance:
    """Let a magnetoresistive film lose magnetisation, and with it gain, until the next of some irregular set pulses."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    mean_s = scene.duration_s / rng.uniform(4, 10)
    pulses_s = np.cumsum(mean_s * rng.uniform(0.6, 1.4, 30)) - mean_s
    since_s = scene.time_s - np.append(-rng.random() * mean_s, pulses_s)[np.searchsorted(pulses_s, scene.time_s)]
    faded = 1 - np.exp(-since_s / (mean_s * rng.uniform(0.5, 1.5)))
    change = -1e-9 * mask * rng.uniform(0.6, 1.4, 3) * faded[:, None] * scene.core(sensor)
    return in_one_sensor(scene, "fading_film", sensor, mask, change, {"mean_s": mean_s})


def degauss_residue(rng: Generator, scene: Scene) -> Disturbance:
    """Leave another residual magnetisation in a core each time that it is degaussed, at a fixed interval."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    interval_s = scene.step_s * rng.uniform(16, max(20, min(60, scene.sample_count / 14)))
    cycle = (scene.time_s / interval_s + rng.random()).astype(int)
    change = 1e-9 * mask * rng.normal(size=(cycle[-1] + 1, 3))[cycle]
    return in_one_sensor(scene, "degauss_residue", sensor, mask, change, {"interval_s": interval_s})


def barkhausen_noise(rng: Generator, scene: Scene) -> Disturbance:
    """Let domain walls jump in a core at random while the field along it changes, and rest while it does not."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    width = rng.uniform(1.5, 4)
    path = np.abs(np.diff(scene.core(sensor), axis=0, prepend=scene.core(sensor)[:1]))
    keep = np.exp(-path / width)
    wall, course = rng.normal(size=3), []
    for kept, jump in zip(keep, np.sqrt(1 - keep**2) * rng.normal(size=path.shape), strict=True):
        wall = kept * wall + jump
        course.append(wall)
    change = 1e-9 * mask * np.array(course)
    return in_one_sensor(scene, "barkhausen_noise", sensor, mask, change, {"width": width})


def hanging_mass(rng: Generator, scene: Scene) -> Disturbance:
    """Let the weight of the moving mass of a micromechanical sensor bend its spring, which stiffens."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    springs = np.stack([draw_direction(rng) for _ in range(3)])
    soft = rng.uniform(0.5, 2)
    bent = np.tanh(soft * scene.to_world[:, 2] @ springs.T) / soft
    change = 1e-9 * mask * rng.uniform(0.5, 1.5, 3) * bent
    return in_one_sensor(scene, "hanging_mass", sensor, mask, change, {"springs": numbers(springs)})


def lost_lock(rng: Generator, scene: Scene) -> Disturbance:
    """Let the oscillator of a scalar run free, to anywhere, while the field lies in one of its dead zones."""
    cosine = np.abs(scene.field_T @ draw_direction(rng)) / scene.intensity_T
    depth = cosine if rng.random() < 0.5 else -cosine
    is_free = depth > np.quantile(depth, 1 - rng.uniform(0.12, 0.35))
    follow = 1 - np.exp(-1 / rng.uniform(2, 8))
    error, target, course = 0.0, 0.0, []
    for free in is_free.tolist():
        if not free:
            error, target = 0.0, rng.normal()
        error += free * follow * (target - error)
        course.append(error)
    change = proportional(of_scalar(scene, 1e-9 * np.array(course) / np.std(course)))
    return Disturbance("lost_lock", (SCALAR,), (), change, "nT", {"share": float(is_free.mean())})


def automatic_gain(rng: Generator, scene: Scene) -> Disturbance:
    """Let an amplifier turn its gain down at once where the field along an axis is large, and up again slowly."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    attack = 1 - np.exp(-1 / rng.uniform(1, 4))
    release = 1 - np.exp(-1 / (scene.sample_count * rng.uniform(0.03, 0.12)))
    size = np.abs(scene.core(sensor))
    level, course = size[0], []
    for one in size:
        level = level + np.where(one > level, attack, release) * (one - level)
        course.append(level)
    change = -1e-9 * mask * rng.uniform(0.6, 1.4, 3) * np.array(course) * scene.core(sensor)
    return in_one_sensor(scene, "automatic_gain", sensor, mask, change, {"release": float(release)})


def adaptive_zero(rng: Generator, scene: Scene) -> Disturbance:
    """Let a phone's firmware subtract, now and then, a part of the middle between the latest extremes of its axes."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    window = int(scene.sample_count * rng.uniform(0.06, 0.15))
    every = int(window * rng.uniform(0.2, 0.6))
    core, zero = scene.core(sensor), np.zeros((scene.sample_count, 3))
    for now in range(int(rng.integers(every)), scene.sample_count, every):
        recent = core[max(0, now - window) : now + 1]
        zero[now:] = (recent.max(axis=0) + recent.min(axis=0)) / 2
    parameters = {"window_samples": window, "every_samples": every}
    return in_one_sensor(scene, "adaptive_zero", sensor, mask, -1e-9 * mask * zero, parameters)


def coarse_compensation(rng: Generator, scene: Scene) -> Disturbance:
    """Take a drift with temperature off by a table of whole steps of the temperature of a chip."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    chip_C = scene.temperature(scene.time_s - scene.duration_s * rng.uniform(0.005, 0.05))
    step_C = np.ptp(chip_C) / rng.uniform(2.5, 5)
    left = (chip_C / step_C + rng.random()) % 1
    change = 1e-9 * np.outer(left, mask * rng.choice([-1.0, 1.0], 3) * rng.uniform(0.5, 1.5, 3))
    return in_one_sensor(scene, "coarse_compensation", sensor, mask, change, {"step_C": float(step_C)})


def drifting_clock(rng: Generator, scene: Scene) -> Disturbance:
    """Let a sensor's own clock run fast or slow and now and then be set; the delays are right on the mean."""
    sensor = draw_sensor(rng, scene)
    sets_s = np.sort(rng.uniform(0.1, 0.9, int(rng.integers(0, 5)))) * scene.duration_s
    since_s = scene.time_s - np.append(0, sets_s)[np.searchsorted(sets_s, scene.time_s, side="right")]
    course = rng.choice([-1.0, 1.0]) * since_s / since_s.std()
    course += rng.uniform(0.1, 0.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    late = (course - course.mean()) / course.std()

    def change(amplitude: float, _seen: object) -> Signal:
        read = scene.readings_at(scene.time_s - amplitude * late)[:, sensor]
        return of_sensors(scene, {sensor: read - scene.readings_T[:, sensor]})

    return Disturbance("drifting_clock", (sensor + 1,), (), change, "s", {"sets_s": numbers(sets_s)})
