"""Causes outside the library, the sealed half. Who writes rules of the diagnosis does not open this file.

Nor the files whose names begin like this one's, their test, or the keys of cases that hold such a cause: these are read
as counts only. A judgement on causes that somebody tuned for says nothing about those that nobody thought of.
"""

import numpy as np
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
from tam_calibration.blind.entry import MOVING, sealed
from tam_calibration.blind.outside_sealed_whole import (
    SWUNG,
    compass_needle,
    drifting_clock,
    fluttering_tow,
    heading_gear,
    irregular_strokes,
    lost_motion,
    moved_soft_iron,
    whipping_boom,
)
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


SEALED = {
    "fading_film": sealed(fading_film),
    "degauss_residue": sealed(degauss_residue),
    "barkhausen_noise": sealed(barkhausen_noise),
    "automatic_gain": sealed(automatic_gain),
    "adaptive_zero": sealed(adaptive_zero),
    "coarse_compensation": sealed(coarse_compensation),
    "hanging_mass": sealed(hanging_mass),
    "lost_lock": sealed(lost_lock, motions=MOVING, scalar_needed=True),
    "lost_motion": sealed(lost_motion, motions=SWUNG),
    "fluttering_tow": sealed(fluttering_tow),
    "whipping_boom": sealed(whipping_boom, motions=MOVING),
    "compass_needle": sealed(compass_needle),
    "moved_soft_iron": sealed(moved_soft_iron),
    "heading_gear": sealed(heading_gear, motions=SWUNG),
    "irregular_strokes": sealed(irregular_strokes),
    "drifting_clock": sealed(drifting_clock, motions=MOVING),
}
"""The causes by their names."""
