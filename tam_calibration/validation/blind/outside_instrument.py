"""Causes outside the library, the open half: in the instrument, and in what reads it out."""

import numpy as np
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_calibration.validation.blind.disturbance import (
    ALL_AXES,
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_direction,
    draw_sensor,
    in_one_sensor,
    named,
    numbers,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_calibration.validation.blind.processes import draw_wander
from tam_calibration.validation.blind.scene import Scene


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


_LEAST_HANDOVERS, _TRIES = 6, 50
"""What is handed over less often is a bias that jumps."""


def weak_bit(rng: Generator, scene: Scene) -> Disturbance:
    """Let one middle bit of a converter weigh too little: the error is there for every second stretch of codes.

    Source: Kester, Data Conversion Handbook, Newnes 2005, section 5.2.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    weight_T = 2 * scene.intensity_T.mean() / rng.uniform(10, 60)
    is_set = np.floor(scene.readings_T[:, sensor] / weight_T) % 2
    change = -1e-9 * mask * rng.uniform(0.6, 1.4, 3) * is_set
    return in_one_sensor(scene, "weak_bit", sensor, mask, change, {"weight_nT": float(weight_T * 1e9)})


def shared_reference(rng: Generator, scene: Scene) -> Disturbance:
    """Let the currents that the other two axes draw, of either sign, pull down the reference of an axis' gain."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    core = scene.core(sensor)
    drawn = np.abs(core) @ (1 - np.eye(3))
    change = -1e-9 * mask * rng.uniform(0.6, 1.4, 3) * drawn * core
    return in_one_sensor(scene, "shared_reference", sensor, mask, change, {})


def reference_noise(rng: Generator, scene: Scene) -> Disturbance:
    """Let the reference voltage of a sensor's three converters be noisy: they err together, along the reading."""
    sensor = draw_sensor(rng, scene)
    noise = rng.normal(size=(scene.sample_count, 1))
    return in_one_sensor(scene, "reference_noise", sensor, ALL_AXES, 1e-9 * noise * scene.core(sensor), {})


def idle_tone(rng: Generator, scene: Scene) -> Disturbance:
    """Let the loop of a sigma-delta converter sing, at a frequency in proportion to what it converts.

    Source: Schreier and Temes, Understanding Delta-Sigma Data Converters, Wiley 2005, section 2.6.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    highest = rng.uniform(0.15, 0.45)
    turned = 2 * np.pi * highest * np.cumsum(scene.core(sensor), axis=0)
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * np.sin(turned + rng.uniform(0, 2 * np.pi, 3))
    return in_one_sensor(scene, "idle_tone", sensor, mask, change, {"highest_cycles_per_sample": highest})


def slew_limit(rng: Generator, scene: Scene) -> Disturbance:
    """Let the integrator of an axis follow the field no faster than it can, and catch up when that is slower."""
    sensor, mask = draw_sensor(rng, scene), np.eye(3)[rng.integers(3)]
    reading = scene.readings_T[:, sensor] @ mask
    steps = np.diff(scene.time_s, prepend=scene.time_s[0] - scene.step_s) / scene.step_s
    fastest_T = np.abs(np.diff(reading, prepend=reading[0]) / steps).max()

    def change(amplitude: float, _seen: object) -> Signal:
        limit_T = max(fastest_T - amplitude, 0.05 * fastest_T)
        return of_sensors(scene, {sensor: np.outer(_followed(reading, limit_T * steps) - reading, mask)})

    parameters = {"fastest_nT_a_sample": float(fastest_T * 1e9)}
    unit = "T a sample below the fastest"
    return Disturbance("slew_limit", (sensor + 1,), named(mask), change, unit, parameters)


def _followed(values: FloatArray, limits: FloatArray) -> FloatArray:
    """Follow values (N,) by no more than a limit (N,) in each step."""
    now, path = values[0], []
    for value, limit in zip(values.tolist(), limits.tolist(), strict=True):
        now += min(max(value - now, -limit), limit)
        path.append(now)
    return np.array(path)


def report_on_change(rng: Generator, scene: Scene) -> Disturbance:
    """Let a bus report each axis only when it has left a band about what was reported last."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)

    def change(amplitude: float, seen: Signal) -> Signal:
        reading = seen[0][:, sensor]
        reported = np.stack([_reported(one, amplitude) for one in reading.T], axis=1)
        return of_sensors(scene, {sensor: mask * (reported - reading)})

    return Disturbance("report_on_change", (sensor + 1,), named(mask), change, "T of the band", {}, after_noise=True)


def _reported(values: FloatArray, band: float) -> FloatArray:
    """Return the last of the values (N,) that was out of the band about the one before it."""
    last, path = values[0], []
    for value in values.tolist():
        last = value if abs(value - last) > band else last
        path.append(last)
    return np.array(path)


def polled_sensor(rng: Generator, scene: Scene) -> Disturbance:
    """Poll a sensor that runs at a rate of its own: the age of its latest reading grows to a period, then is none."""
    sensor = draw_sensor(rng, scene)
    beats = rng.uniform(8, 40)
    slip = rng.uniform(0, 0.4) * draw_wander(rng, scene.duration_s, 6)(scene.time_s)
    phase = beats * scene.time_s / scene.duration_s + slip
    late = rng.choice([-1.0, 1.0]) * (phase % 1 - 0.5) * 12**0.5

    def change(amplitude: float, _seen: object) -> Signal:
        read = scene.readings_at(scene.time_s - amplitude * late)[:, sensor]
        return of_sensors(scene, {sensor: read - scene.readings_T[:, sensor]})

    return Disturbance("polled_sensor", (sensor + 1,), (), change, "s", {"beats": beats})


def gyro_fusion(rng: Generator, scene: Scene) -> Disturbance:
    """Let firmware turn its last reading by a gyroscope that errs in scale and axes, and pull it to the true one.

    Source: Mahony, Hamel and Pflimlin, Nonlinear complementary filters, IEEE Trans. Autom. Control 53, 2008.
    """
    sensor = draw_sensor(rng, scene)
    errs, memory = rng.normal(size=(3, 3)), rng.uniform(5, 30)
    wrong = np.cross(scene.motion.turning_rate(scene.time_s, scene.step_s / 50) @ errs.T, scene.core(sensor))
    back = np.einsum("nji,njk->nik", scene.to_world[1:], scene.to_world[:-1])
    error, course = np.zeros(3), [np.zeros(3)]
    for turn, added in zip(back, wrong[1:] / wrong.std(), strict=True):
        error = np.exp(-1 / memory) * turn @ error + added
        course.append(error)
    parameters = {"memory_samples": memory}
    return in_one_sensor(scene, "gyro_fusion", sensor, ALL_AXES, 1e-9 * np.array(course), parameters)


def cell_handover(rng: Generator, scene: Scene) -> Disturbance:
    """Let a scalar of two cells read the one with the stronger signal, which it leaves late; the cells do not agree."""
    for _ in range(_TRIES):
        cosine = scene.field_T @ draw_direction(rng) / scene.intensity_T
        middle, half = np.quantile(cosine, rng.uniform(0.35, 0.65)), rng.uniform(0.03, 0.12) * np.ptp(cosine)
        second = _kept(cosine - middle, half)
        handovers = int(np.abs(np.diff(second)).sum())
        if handovers >= _LEAST_HANDOVERS:
            break
    change = 1e-9 * second * (rng.choice([-1.0, 1.0]) + rng.uniform(-0.4, 0.4) * cosine)
    parameters = {"handovers": handovers, "late_by": float(half)}
    return Disturbance("cell_handover", (SCALAR,), (), proportional(of_scalar(scene, change)), "nT", parameters)


def _kept(values: FloatArray, half: float) -> FloatArray:
    """Return a state (N,) that is one above a band about zero, nought below it, and as it was within."""
    state, path = float(values[0] > 0), []
    for value in values.tolist():
        state = state if abs(value) <= half else float(value > 0)
        path.append(state)
    return np.array(path)
