"""Causes outside the library, the open half: cables, mounts, loads and currents of the vehicle around a sensor."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.blind.disturbance import (
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
)
from tam_calibration.blind.processes import draw_wander
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray

_WHOLE = np.ones(3)


def cable_windup(rng: Generator, scene: Scene) -> Disturbance:
    """Let a cable wind up with the heading, turn after turn, and twist a sensor in its mount."""
    sensor, axis = draw_sensor(rng, scene), draw_direction(rng)
    wound = scene.motion.angles(scene.time_s)[:, 0]
    twist = (wound - wound.mean()) / wound.std()
    change = 1e-9 * np.cross(axis, scene.core(sensor)) * twist[:, None]
    return in_one_sensor(scene, "cable_windup", sensor, _WHOLE, change, {"axis": numbers(axis)})


def rubber_mount(rng: Generator, scene: Scene) -> Disturbance:
    """Hang a sensor in rubber, which gives way to the weight slowly: an arm that bends, but later."""
    sensor = draw_sensor(rng, scene)
    memory, compliance = rng.uniform(8, 40), rng.normal(size=(3, 3))
    weight, keep = -scene.to_world[:, 2], np.exp(-1 / memory)
    sunk = lfilter([1 - keep], [1, -keep], weight - weight[0], axis=0) + weight[0]
    change = 1e-9 * np.cross(sunk @ compliance.T, scene.core(sensor))
    return in_one_sensor(scene, "rubber_mount", sensor, _WHOLE, change, {"memory_samples": memory})


def sliding_tray(rng: Generator, scene: Scene) -> Disturbance:
    """Let a magnetised tray of batteries slide along a rail, as fast as that is steep, from one stop to the other."""
    sensor, rail = draw_sensor(rng, scene), draw_direction(rng)
    speed = 1 / rng.uniform(3, 20)
    place = _slid(-speed * (scene.to_world[:, 2] @ rail))
    # In half lengths of the rail.
    away = rng.uniform(1.5, 3) * draw_direction(rng) - np.outer(place, rail)
    dipole = _dipole(draw_direction(rng), away)
    change = 1e-9 * dipole / norm(dipole - dipole.mean(axis=0), axis=1).max()
    return in_one_sensor(scene, "sliding_tray", sensor, _WHOLE, change, {"rail": numbers(rail), "speed": speed})


def _slid(steps: FloatArray) -> FloatArray:
    """Return the places (N,) that steps (N,) lead to between stops at one to either side."""
    place, path = 0.0, []
    for step in steps.tolist():
        place = min(max(place + step, -1.0), 1.0)
        path.append(place)
    return np.array(path)


def _dipole(moment: FloatArray, away: FloatArray) -> FloatArray:
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
    return in_one_sensor(scene, "steering_current", sensor, _WHOLE, change, {"inertia": inertia})


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
    return in_one_sensor(scene, "viscous_remanence", sensor, _WHOLE, change, {"parked": numbers(parked)})


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
    return in_one_sensor(scene, "sonar_recharge", sensor, _WHOLE, change, parameters)


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
