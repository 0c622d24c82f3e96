"""Causes outside the library, the open half: mounts that give way, and iron that the platform moves."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.blind.disturbance import (
    Disturbance,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
)
from tam_calibration.blind.processes import draw_wander
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray

_LEAST_REVERSALS = 6
"""A joint that reverses less often is a mount that slips."""

_WHOLE = np.ones(3)


def lost_motion(rng: Generator, scene: Scene) -> Disturbance:
    """Turn a sensor in a joint by its play, one way or the other, each time that the joint's motion reverses."""
    sensor = draw_sensor(rng, scene)
    angles = scene.motion.angles(scene.time_s)
    courses = [_behind(angle, rng.uniform(0.02, 0.1) * np.ptp(angle)) for angle in angles.T]
    reversals = [int(np.sum(np.diff(np.sign(course[course != 0])) != 0)) for course in courses]
    often = [joint for joint in range(3) if reversals[joint] >= _LEAST_REVERSALS]
    joint = int(rng.choice(often or [int(np.argmax(reversals))]))
    axis = draw_direction(rng)
    change = 1e-9 * courses[joint][:, None] * np.cross(axis, scene.core(sensor))
    parameters = {"axis": numbers(axis), "reversals": reversals[joint]}
    return in_one_sensor(scene, "lost_motion", sensor, _WHOLE, change, parameters)


def _behind(angle: FloatArray, play: float) -> FloatArray:
    """Return how far (N,) a driven part is behind, in units of the play on either side."""
    behind, course = 0.0, []
    for step in np.diff(angle, prepend=angle[0]).tolist():
        behind = min(max(behind + step / play, -1.0), 1.0)
        course.append(behind)
    return np.array(course)


def fluttering_tow(rng: Generator, scene: Scene) -> Disturbance:
    """Let vortices make a towed sensor flutter about an axis, in a narrow band and never for long in phase."""
    sensor, axis = draw_sensor(rng, scene), draw_direction(rng)
    period = rng.uniform(12, 30)
    pole = np.exp(2j * np.pi / period - 1 / (period * rng.uniform(1, 3)))
    kicks = rng.normal(size=(2, scene.sample_count))
    angle = lfilter([1.0], [1.0, -pole], kicks[0] + 1j * kicks[1]).real
    change = 1e-9 * (angle / angle.std())[:, None] * np.cross(axis, scene.core(sensor))
    return in_one_sensor(scene, "fluttering_tow", sensor, _WHOLE, change, {"period_samples": period})


def whipping_boom(rng: Generator, scene: Scene) -> Disturbance:
    """Twist and bend a boom by the inertia of what it carries, as the array's rotation speeds up and slows down."""
    sensor = draw_sensor(rng, scene)
    half_s = scene.step_s / 4
    rates = [scene.motion.turning_rate(scene.time_s + shift_s, half_s / 10) for shift_s in (-half_s, half_s)]
    compliance = rng.normal(size=(3, 3))
    angle = (rates[1] - rates[0]) @ compliance.T
    change = 1e-9 * np.cross(angle / angle.std(), scene.core(sensor))
    return in_one_sensor(scene, "whipping_boom", sensor, _WHOLE, change, {"compliance": numbers(compliance)})


def compass_needle(rng: Generator, scene: Scene) -> Disturbance:
    """Mount a compass beside a sensor: its needle points along the field in the plane of its card."""
    sensor, pivot = draw_sensor(rng, scene), draw_direction(rng)
    in_plane = scene.field_T - np.outer(scene.field_T @ pivot, pivot)
    needle = in_plane / norm(in_plane, axis=1, keepdims=True)
    change = 1e-9 * _dipole(needle, draw_direction(rng))
    return in_one_sensor(scene, "compass_needle", sensor, _WHOLE, change, {"pivot": numbers(pivot)})


def moved_soft_iron(rng: Generator, scene: Scene) -> Disturbance:
    """Let a servo turn a rod of soft iron to one angle after another; the field magnetises it along the rod."""
    sensor = draw_sensor(rng, scene)
    moves = int(rng.integers(10, 24))
    starts_s = np.sort(rng.uniform(0, 1, moves)) * scene.duration_s
    settings = rng.uniform(-1.2, 1.2, moves + 1)
    takes_s = scene.duration_s * rng.uniform(0.01, 0.03)
    moved = np.clip((scene.time_s[:, None] - starts_s) / takes_s, 0, 1)
    angle = settings[0] + moved @ np.diff(settings)
    first = draw_direction(rng)
    second = np.cross(first, draw_direction(rng))
    rod = np.outer(np.cos(angle), first) + np.outer(np.sin(angle), second / norm(second))
    along = (rod * scene.field_T).sum(axis=1, keepdims=True) / scene.intensity_T.mean()
    change = 1e-9 * _dipole(along * rod, draw_direction(rng))
    return in_one_sensor(scene, "moved_soft_iron", sensor, _WHOLE, change, {"moves": moves})


def _dipole(moment: FloatArray, direction: FloatArray) -> FloatArray:
    """Return the field (N, 3) of moments (N, 3) in a direction, at a distance of one."""
    return np.asarray(3 * np.outer(moment @ direction, direction) - moment)


def heading_gear(rng: Generator, scene: Scene) -> Disturbance:
    """Let a magnetised wheel that is geared to the heading turn several times as fast, and slip."""
    sensor = draw_sensor(rng, scene)
    ratio = rng.choice([-1.0, 1.0]) * rng.uniform(2.2, 5)
    slip = rng.uniform(0.5, 1.5) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    phase = ratio * scene.motion.angles(scene.time_s)[:, 0] + slip
    waves = np.stack([np.cos(phase), np.sin(phase), rng.uniform(0, 0.4) * np.cos(2 * phase)], axis=1)
    change = 1e-9 * waves @ np.stack([draw_direction(rng) for _ in range(3)])
    return in_one_sensor(scene, "heading_gear", sensor, _WHOLE, change, {"ratio": ratio})


def irregular_strokes(rng: Generator, scene: Scene) -> Disturbance:
    """Swing a magnetised leg, fin or piston to a sensor and away, no stroke as long or as wide as the one before."""
    sensor = draw_sensor(rng, scene)
    mean = rng.uniform(14, 40)
    count = int(2 * scene.duration_s / (scene.step_s * mean)) + 2
    edges_s = np.cumsum(scene.step_s * mean * rng.uniform(0.65, 1.35, count)) - scene.step_s * mean
    stroke = np.interp(scene.time_s, edges_s, np.arange(count))
    width = rng.uniform(0.5, 1.5, count)[stroke.astype(int)]
    turn = 2 * np.pi * stroke
    near = width * ((1 - np.cos(turn)) / 2) ** rng.uniform(1, 3)
    change = 1e-9 * (np.outer(near, draw_direction(rng)) + np.outer(near * np.sin(turn), draw_direction(rng)))
    return in_one_sensor(scene, "irregular_strokes", sensor, _WHOLE, change, {"mean_samples": mean})
