"""Causes outside the library, the open half: those that have a course in time of their own, or follow the motion."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import (
    SCALAR,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    numbers,
    of_scalar,
    proportional,
    where_strong,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene


def ageing_bias(rng: Generator, scene: Scene) -> Disturbance:
    """Let a bias settle after switching on, by the logarithm of the time since, with a little wandering."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    since = np.log1p(scene.time_s / (scene.duration_s * 10 ** rng.uniform(-2.5, -0.7)))
    wander = draw_wander(rng, scene.duration_s, 5)(scene.time_s)
    course = since / since.std() + rng.uniform(0.1, 0.4) * wander
    return in_one_sensor(scene, "ageing_bias", sensor, mask, 1e-9 * np.outer(course, mask * rng.normal(size=3)), {})


def creeping_bias(rng: Generator, scene: Scene) -> Disturbance:
    """Let glue give way: the bias of each axis goes elsewhere over minutes, and part of the way back."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    share = (scene.time_s / scene.duration_s)[:, None]
    middle = np.sort(rng.uniform(0.1, 0.9, (2, 3)), axis=0)
    width = rng.uniform(0.06, 0.2, (2, 3))
    course = np.tanh((share - middle[0]) / width[0]) - rng.uniform(0.2, 0.9, 3) * np.tanh(
        (share - middle[1]) / width[1]
    )
    change = 1e-9 * mask * rng.normal(size=3) * course
    return in_one_sensor(scene, "creeping_bias", sensor, mask, change, {"middles": numbers(middle)})


def cycling_bias(rng: Generator, scene: Scene) -> Disturbance:
    """Let a thermostat nobody recorded switch a heater, each time after another while; the bias follows."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    cycles = rng.uniform(2.5, 6)
    spans = scene.duration_s / (2 * cycles) * rng.uniform(0.6, 1.4, 40)
    edges_s = np.cumsum(spans) - spans[0] * rng.random()
    heated = np.searchsorted(edges_s, scene.time_s) % 2
    lag_s = scene.duration_s / (2 * cycles) * rng.uniform(0.3, 1.5)
    warm, course = 0.5, []
    for on, step_s in zip(heated.tolist(), np.diff(scene.time_s, prepend=scene.time_s[0]).tolist(), strict=True):
        warm += (on - warm) * (1 - np.exp(-step_s / lag_s))
        course.append(warm)
    change = 1e-9 * np.outer(course, mask * rng.normal(size=3))
    return in_one_sensor(scene, "cycling_bias", sensor, mask, change, {"cycles": cycles})


def supply_sag(rng: Generator, scene: Scene) -> Disturbance:
    """Let bias and gain follow a battery that runs down, sags under each of many loads and recovers slowly."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    time_s, duration_s = scene.time_s, scene.duration_s
    volts = -rng.uniform(0.5, 1.5) * (time_s / duration_s) ** rng.uniform(1, 2.5)
    for _ in range(int(rng.integers(9, 22))):
        since_s = time_s - rng.uniform(-0.05, 1) * duration_s
        held_s, recovers_s = duration_s * rng.uniform(0.01, 0.05), duration_s * rng.uniform(0.01, 0.06)
        loaded = (since_s >= 0) & (since_s < held_s)
        after = np.where(since_s >= held_s, np.exp(-np.maximum(since_s - held_s, 0) / recovers_s), 0.0)
        volts -= rng.uniform(0.3, 1) * (loaded + rng.uniform(0.3, 0.6) * after)
    gain = rng.uniform(0, 0.7) * rng.normal(size=3) * scene.core(sensor)
    change = 1e-9 * mask * volts[:, None] * (rng.normal(size=3) + gain)
    return in_one_sensor(scene, "supply_sag", sensor, mask, change, {})


def relaxing_tail(rng: Generator, scene: Scene) -> Disturbance:
    """Kick the iron beside a sensor a few times: what each kick magnetised fades with the logarithm of time."""
    sensor = draw_sensor(rng, scene)
    course = np.zeros((scene.sample_count, 3))
    kicks_s = np.sort(rng.uniform(-0.05, 0.9, int(rng.integers(5, 9)))) * scene.duration_s
    for kick_s in kicks_s:
        since = np.maximum(scene.time_s - kick_s, 0) / (scene.duration_s * 10 ** rng.uniform(-3, -2))
        left = np.maximum(1 - 0.45 * np.log10(1 + since), 0) * (scene.time_s >= kick_s)
        course += np.outer(left, rng.uniform(0.5, 1.5) * draw_direction(rng))
    parameters = {"kicks_s": numbers(kicks_s)}
    return in_one_sensor(scene, "relaxing_tail", sensor, np.ones(3), 1e-9 * course, parameters)


def spinning_part(rng: Generator, scene: Scene) -> Disturbance:
    """Turn a magnetised part near a sensor whose speed runs up and down by a factor of two and more."""
    sensor = draw_sensor(rng, scene)
    low_hz = rng.uniform(0.04, 0.12) / scene.step_s
    speed = draw_wander(rng, scene.duration_s, 6)
    fine_s = np.linspace(0, scene.duration_s, 20_000)
    rate_hz = low_hz * (1 + rng.uniform(1, 2) * (1 + np.tanh(speed(fine_s))) / 2)
    phase = 2 * np.pi * np.interp(scene.time_s, fine_s, np.cumsum(rate_hz) * fine_s[1])
    first, second = draw_direction(rng), draw_direction(rng)
    change = 1e-9 * (np.outer(np.cos(phase), first) + np.outer(np.sin(phase), second))
    return in_one_sensor(scene, "spinning_part", sensor, np.ones(3), change, {"lowest_hz": low_hz})


def burst_noise(rng: Generator, scene: Scene) -> Disturbance:
    """Let a contact or a semiconductor flip between two offsets, at any time, in an axis or the scalar."""
    rates = rng.uniform(15, 60, 2) / scene.duration_s
    stays_s = rng.exponential(1 / np.tile(rates, 200))
    course = np.searchsorted(np.cumsum(stays_s), scene.time_s) % 2.0
    if scene.with_scalar and rng.random() < 0.3:
        change = proportional(of_scalar(scene, 1e-9 * course))
        return Disturbance("burst_noise", (SCALAR,), (), change, "nT", {})
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.7)
    return in_one_sensor(scene, "burst_noise", sensor, mask, 1e-9 * np.outer(course, mask * rng.normal(size=3)), {})


def passing_iron(rng: Generator, scene: Scene) -> Disturbance:
    """Carry a magnetised tool past one sensor, twice or more, each time another way."""
    while True:
        sensor = draw_sensor(rng, scene)
        others = np.delete(scene.positions_m, sensor, axis=0) - scene.positions_m[sensor]
        nearest_m = norm(others, axis=1).min()
        extra = np.zeros((scene.sample_count, scene.sensor_count + 1, 3))
        for _ in range(int(rng.integers(2, 5))):
            extra += _pass(rng, scene, scene.positions_m[sensor], nearest_m * rng.uniform(0.1, 0.2))
        vectors = scene.through(extra[:, :-1])
        sensors = where_strong(scene, vectors)
        if sensors == (sensor + 1,):
            break
    strength = 1e-9 / norm(extra[:, sensor], axis=1).max()
    scalar = (extra[:, -1] * scene.field_T).sum(axis=1) / scene.intensity_T
    change = proportional((strength * vectors, strength * scalar))
    return Disturbance("passing_iron", sensors, (), change, "nT at the most", {})


def _pass(rng: Generator, scene: Scene, place_m: FloatArray, near_m: float) -> FloatArray:
    """Return the field of a dipole that goes by, at the sensors and the center (N, K + 1, 3), in the array's frame."""
    across = draw_direction(rng)
    along = np.cross(across, draw_direction(rng))
    along /= norm(along)
    width_s = scene.duration_s * rng.uniform(0.02, 0.06)
    way = np.outer((scene.time_s - rng.uniform(0.1, 0.9) * scene.duration_s) / width_s, along)
    source = place_m + near_m * (across + way)
    at = np.concatenate([scene.positions_m, np.zeros((1, 3))])
    away = at[None] - source[:, None]
    distance = norm(away, axis=2, keepdims=True)
    unit, moment = away / distance, draw_direction(rng)
    return np.asarray((3 * unit * (unit @ moment)[..., None] - moment) / distance**3)


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
