"""Causes outside the library, the open half: mounts, loads, cables, iron and currents of the platform."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import (
    ALL_AXES,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene

_LEAST_REVERSALS = 6
"""A joint that reverses less often is a mount that slips."""


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
    return in_one_sensor(scene, "lost_motion", sensor, ALL_AXES, change, parameters)


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
    return in_one_sensor(scene, "fluttering_tow", sensor, ALL_AXES, change, {"period_samples": period})


def whipping_boom(rng: Generator, scene: Scene) -> Disturbance:
    """Twist and bend a boom by the inertia of what it carries, as the array's rotation speeds up and slows down."""
    sensor = draw_sensor(rng, scene)
    half_s = scene.step_s / 4
    rates = [scene.motion.turning_rate(scene.time_s + shift_s, half_s / 10) for shift_s in (-half_s, half_s)]
    compliance = rng.normal(size=(3, 3))
    angle = (rates[1] - rates[0]) @ compliance.T
    change = 1e-9 * np.cross(angle / angle.std(), scene.core(sensor))
    return in_one_sensor(scene, "whipping_boom", sensor, ALL_AXES, change, {"compliance": numbers(compliance)})


def compass_needle(rng: Generator, scene: Scene) -> Disturbance:
    """Mount a compass beside a sensor: its needle points along the field in the plane of its card."""
    sensor, pivot = draw_sensor(rng, scene), draw_direction(rng)
    in_plane = scene.field_T - np.outer(scene.field_T @ pivot, pivot)
    needle = in_plane / norm(in_plane, axis=1, keepdims=True)
    change = 1e-9 * _dipole(needle, draw_direction(rng))
    return in_one_sensor(scene, "compass_needle", sensor, ALL_AXES, change, {"pivot": numbers(pivot)})


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
    return in_one_sensor(scene, "moved_soft_iron", sensor, ALL_AXES, change, {"moves": moves})


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
    return in_one_sensor(scene, "heading_gear", sensor, ALL_AXES, change, {"ratio": ratio})


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
    return in_one_sensor(scene, "irregular_strokes", sensor, ALL_AXES, change, {"mean_samples": mean})


def cable_windup(rng: Generator, scene: Scene) -> Disturbance:
    """Let a cable wind up with the heading, turn after turn, and twist a sensor in its mount."""
    sensor, axis = draw_sensor(rng, scene), draw_direction(rng)
    wound = scene.motion.angles(scene.time_s)[:, 0]
    twist = (wound - wound.mean()) / wound.std()
    change = 1e-9 * np.cross(axis, scene.core(sensor)) * twist[:, None]
    return in_one_sensor(scene, "cable_windup", sensor, ALL_AXES, change, {"axis": numbers(axis)})


def rubber_mount(rng: Generator, scene: Scene) -> Disturbance:
    """Hang a sensor in rubber, which gives way to the weight slowly: an arm that bends, but later."""
    sensor = draw_sensor(rng, scene)
    memory, compliance = rng.uniform(8, 40), rng.normal(size=(3, 3))
    weight, keep = -scene.to_world[:, 2], np.exp(-1 / memory)
    sunk = lfilter([1 - keep], [1, -keep], weight - weight[0], axis=0) + weight[0]
    change = 1e-9 * np.cross(sunk @ compliance.T, scene.core(sensor))
    return in_one_sensor(scene, "rubber_mount", sensor, ALL_AXES, change, {"memory_samples": memory})


def sliding_tray(rng: Generator, scene: Scene) -> Disturbance:
    """Let a magnetised tray of batteries slide along a rail, as fast as that is steep, from one stop to the other."""
    sensor, rail = draw_sensor(rng, scene), draw_direction(rng)
    speed = 1 / rng.uniform(3, 20)
    place = _slid(-speed * (scene.to_world[:, 2] @ rail))
    # In half lengths of the rail.
    away = rng.uniform(1.5, 3) * draw_direction(rng) - np.outer(place, rail)
    dipole = _dipole_at(draw_direction(rng), away)
    change = 1e-9 * dipole / norm(dipole - dipole.mean(axis=0), axis=1).max()
    return in_one_sensor(scene, "sliding_tray", sensor, ALL_AXES, change, {"rail": numbers(rail), "speed": speed})


def _slid(steps: FloatArray) -> FloatArray:
    """Return the places (N,) that steps (N,) lead to between stops at one to either side."""
    place, path = 0.0, []
    for step in steps.tolist():
        place = min(max(place + step, -1.0), 1.0)
        path.append(place)
    return np.array(path)


def _dipole_at(moment: FloatArray, away: FloatArray) -> FloatArray:
    """Return the field (N, 3) of a moment (3,) at distances (N, 3) from it."""
    distance = norm(away, axis=1, keepdims=True)
    unit = away / distance
    return np.asarray((3 * unit * (unit @ moment)[:, None] - moment) / distance**3)


def steering_current(rng: Generator, scene: Scene) -> Disturbance:
    """Let thrusters turn a vehicle against drag and inertia: the current grows with the power 3/2 of their thrust.

    Source: Leishman, Principles of Helicopter Aerodynamics, Cambridge 2006, section 2.2, on the ideal power.
    """
    sensor = draw_sensor(rng, scene)
    half_s = scene.step_s / 4
    before, after = (scene.motion.turning_rate(scene.time_s + shift_s, half_s / 10) for shift_s in (-half_s, half_s))
    speed_up, rate = after - before, (after + before) / 2
    drag = rate * np.abs(rate)
    inertia = rng.uniform(0.3, 1.0)
    torque = drag / drag.std() + inertia * speed_up / speed_up.std()
    change = 1e-9 * np.abs(torque) ** 1.5 @ rng.normal(size=(3, 3))
    return in_one_sensor(scene, "steering_current", sensor, ALL_AXES, change, {"inertia": inertia})


def viscous_remanence(rng: Generator, scene: Scene) -> Disturbance:
    """Let steel creep after the field that it lies in, by the logarithm of time, from the one in which it was parked.

    Source: Dunlop and Ozdemir, Rock Magnetism, Cambridge 1997, chapter 10: relaxation times in equal parts of a decade.
    """
    sensor, parked = draw_sensor(rng, scene), draw_direction(rng)
    lags_s = scene.duration_s * np.geomspace(0.03, 3, 8)
    keep = np.exp(-np.diff(scene.time_s, prepend=scene.time_s[0])[:, None] / lags_s)[:, :, None]
    parts, course = np.tile(parked, (len(lags_s), 1)), []
    for kept, now in zip(keep, scene.field_T / scene.intensity_T[:, None], strict=True):
        parts = kept * parts + (1 - kept) * now
        course.append(parts.mean(axis=0))
    change = 1e-9 * np.array(course) @ rng.normal(size=(3, 3))
    return in_one_sensor(scene, "viscous_remanence", sensor, ALL_AXES, change, {"parked": numbers(parked)})


def sonar_recharge(rng: Generator, scene: Scene) -> Disturbance:
    """Let a sonar charge its capacitors after each ping, with a current that fades; the depth sets the interval."""
    sensor = draw_sensor(rng, scene)
    shortest, charge = rng.uniform(8, 14), rng.uniform(1.5, 4)
    depth = draw_wander(rng, scene.duration_s, 7)
    fine_s = np.linspace(0, scene.duration_s, 20_000)
    interval_s = scene.step_s * shortest * (2 + np.tanh(depth(fine_s)))
    pings = np.cumsum(fine_s[1] / interval_s) + rng.random()
    since_s = np.interp(scene.time_s, fine_s, pings) % 1 * np.interp(scene.time_s, fine_s, interval_s)
    change = 1e-9 * np.outer(np.exp(-since_s / (charge * scene.step_s)), draw_direction(rng))
    parameters = {"shortest_samples": shortest, "charge_samples": charge}
    return in_one_sensor(scene, "sonar_recharge", sensor, ALL_AXES, change, parameters)


def thermal_play(rng: Generator, scene: Scene) -> Disturbance:
    """Let a package that friction holds strain a sensor: its bias follows the temperature with play, warm or cold.

    Source: Brokate and Sprekels, Hysteresis and Phase Transitions, Springer 1996, section 2.3, on sums of plays.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    warm_C = scene.temperature(scene.time_s)
    halves_C = np.ptp(warm_C) * rng.uniform(0.1, 0.4, 3)
    strain = np.mean([_pulled(warm_C, half_C) for half_C in halves_C], axis=0)
    change = 1e-9 * np.outer((strain - strain.mean()) / strain.std(), mask * rng.normal(size=3))
    return in_one_sensor(scene, "thermal_play", sensor, mask, change, {"halves_C": numbers(halves_C)})


def _pulled(values: FloatArray, half: float) -> FloatArray:
    """Return the path (N,) of what values (N,) pull along when they are further off than a half of the play."""
    now, path = values[0], []
    for value in values.tolist():
        now = min(max(now, value - half), value + half)
        path.append(now)
    return np.array(path)
