"""Matter near or in a sensor: heat, magnetic loops, eddy currents, arms that bend."""

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray
from tam_validation.blind.continuous_motion import about
from tam_validation.blind.disturbance import (
    ALL,
    Disturbance,
    draw_axes,
    draw_direction,
    draw_sensor,
    named,
    numbers,
    of_sensors,
    proportional,
)
from tam_validation.blind.scene import Scene

_FINE = 8000
"""Steps of the heat's integration."""

_MODES = 40
"""Of the diffusion of heat; faster ones follow at once."""

_SMALL_STEP = 0.02
"""Of the field that magnetises, as a share of the intensity."""


def temperature_drift(rng: Generator, scene: Scene) -> Disturbance:
    """Heat warms the housing and diffuses into the sensor; bias and gain follow, with a quadratic part."""
    fine_s = np.linspace(-0.2 * scene.duration_s, scene.duration_s, _FINE)
    outside_C = scene.temperature(fine_s)
    everywhere = scene.sensor_count > 1 and rng.random() < 0.25
    chosen = range(scene.sensor_count) if everywhere else [draw_sensor(rng, scene)]
    rows, parameters = {}, {}
    for sensor in chosen:
        lags_s = scene.duration_s * 10 ** rng.uniform(-2.3, -1.0, 2)
        inside_C = _diffused(low_pass(outside_C, lags_s[0], fine_s), lags_s[1], fine_s)
        warm = (np.interp(scene.time_s, fine_s, inside_C) - inside_C.mean())[:, None] / np.ptp(inside_C)
        bias, gain = rng.normal(size=3), rng.normal(size=3) * rng.uniform(0.2, 1.0)
        bend = rng.uniform(-0.5, 0.5, (2, 3))
        core = (scene.readings_T[:, sensor] - scene.bias_T[sensor]) / scene.intensity_T.mean()
        rows[sensor] = _of_like_size(rng, bias * (warm + bend[0] * warm**2) + gain * core * (warm + bend[1] * warm**2))
        parameters[f"delays_s_{sensor + 1}"] = numbers(lags_s)
    sensors = (ALL,) if everywhere else tuple(sensor + 1 for sensor in chosen)
    change = proportional(of_sensors(scene, rows))
    return Disturbance("temperature_drift", sensors, (), change, "nT", parameters)


def _of_like_size(rng: Generator, rows: FloatArray) -> FloatArray:
    """Scale a signal to about a nanotesla, so that among all sensors none is disturbed much less than the others."""
    return np.asarray(rows * (1e-9 * rng.uniform(0.7, 1.3) / (rows - rows.mean(axis=0)).std()))


def low_pass(values: FloatArray, time_constant_s: float, time_s: FloatArray) -> FloatArray:
    """Follow a function of time with one time constant, exactly for what is constant over a step."""
    keep = np.exp(-(time_s[1] - time_s[0]) / time_constant_s)
    return np.asarray(lfilter([1 - keep], [1, -keep], values - values[0]) + values[0])


def _diffused(values: FloatArray, delay_s: float, time_s: FloatArray) -> FloatArray:
    """Let a temperature diffuse through a slab whose far side loses no heat, by its modes (Carslaw & Jaeger, § 3.4)."""
    order = np.arange(_MODES)
    time_constant_s = 2 * delay_s / ((order + 0.5) * np.pi) ** 2
    part = (-1.0) ** order * 2 / ((order + 0.5) * np.pi)
    modes = sum(one * low_pass(values, tau, time_s) for one, tau in zip(part, time_constant_s, strict=True))
    return np.asarray(modes + (1 - part.sum()) * values)


def hysteresis(rng: Generator, scene: Scene) -> Disturbance:
    """Magnetise the cores of one sensor along its axes, or a rod beside it, by Preisach's relays or Bouc–Wen loops."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    law = _preisach if rng.random() < 0.5 else _bouc_wen
    if rng.random() < 0.6:
        core = (scene.readings_T[:, sensor] - scene.bias_T[sensor]) / scene.intensity_T.mean()
        size = mask * rng.uniform(0.5, 1.5, 3)
        loops = [size[axis] * law(rng, core[:, axis])[0] for axis in range(3)]
        rows, place, parameters = np.stack(loops, axis=1), "cores", dict[str, object](law=law.__name__.strip("_"))
    else:
        along, onto, mask = draw_direction(rng), draw_direction(rng), np.ones(3)
        magnetised, parameters = law(rng, scene.field_T @ along / scene.intensity_T.mean())
        rows, place = np.outer(magnetised, onto), "rod"
        parameters["axis"] = numbers(along)
    change = proportional(of_sensors(scene, {sensor: 1e-9 * rows}))
    parameters["place"] = place
    return Disturbance("hysteresis", (sensor + 1,), named(mask), change, "nT at saturation", parameters)


def _preisach(rng: Generator, drive: FloatArray) -> tuple[FloatArray, dict[str, object]]:
    """Sum relays, each up above its upper threshold and down below its lower one."""
    coercivity, spread = rng.uniform(0.12, 0.35), rng.uniform(0.05, 0.15)
    grid = np.linspace(-1, 1, 60)
    upper, lower = (values.ravel() for values in np.meshgrid(grid, grid))
    half, middle = (upper - lower) / 2, (upper + lower) / 2
    weight = np.exp(-(((half - coercivity) / spread) ** 2) / 2 - (middle / 0.45) ** 2 / 2) * (half > 0)
    weight /= weight.sum()
    state = np.where(middle > 0, -1.0, 1.0)
    total = np.empty(len(drive))
    for sample, value in enumerate(drive):
        state[upper <= value] = 1
        state[lower >= value] = -1
        total[sample] = weight @ state
    return total, {"law": "Preisach", "coercivity": coercivity, "spread": spread}


def _bouc_wen(rng: Generator, drive: FloatArray) -> tuple[FloatArray, dict[str, object]]:
    """Integrate dz = (1 - |z|^n (beta sign(du z) + gamma)) du / width."""
    width, sharpness, beta = rng.uniform(0.15, 0.5), rng.uniform(1, 2.5), rng.uniform(0.5, 0.95)
    steps = int(np.ceil(np.abs(np.diff(drive)).max() / _SMALL_STEP))
    fine = np.interp(np.arange((len(drive) - 1) * steps + 1) / steps, np.arange(len(drive)), drive)
    z, path = 0.0, [0.0]
    for step in np.diff(fine).tolist():
        turn = 1.0 if step * z > 0 else -1.0
        z += step / width * (1 - abs(z) ** sharpness * (beta * turn + 1 - beta))
        path.append(z)
    return np.array(path)[::steps], {"law": "Bouc-Wen", "width": width, "sharpness": sharpness, "beta": beta}


def eddy_current(rng: Generator, scene: Scene) -> Disturbance:
    """Let currents in plates answer to the field's changes and die away; a plate couples the axes."""
    everywhere = scene.sensor_count > 1 and rng.random() < 0.2
    chosen = range(scene.sensor_count) if everywhere else [draw_sensor(rng, scene)]
    time_constant_s = scene.step_s * 10 ** rng.uniform(-0.5, 0.7)
    settle_s = 6 * time_constant_s + scene.step_s
    fine_s = np.arange(-settle_s, scene.duration_s + scene.step_s, min(scene.step_s / 3, time_constant_s / 3))
    field_T = scene.field_at(fine_s)
    answer = field_T - np.stack([low_pass(one, time_constant_s, fine_s) for one in field_T.T], axis=1)
    sampled = np.stack([np.interp(scene.time_s, fine_s, one) for one in answer.T], axis=1)
    rows = {}
    for sensor in chosen:
        root = rng.normal(size=(3, 3))
        coupling = root @ root.T / 3 + 0.3 * rng.normal(size=(3, 3))
        rows[sensor] = _of_like_size(rng, sampled @ coupling.T @ scene.response[sensor].T)
    sensors = (ALL,) if everywhere else (chosen[0] + 1,)
    change = proportional(of_sensors(scene, rows))
    parameters = {"time_constant_s": time_constant_s}
    return Disturbance("eddy_current", sensors, (), change, "nT", parameters)


def flexure(rng: Generator, scene: Scene) -> Disturbance:
    """Arms bend under their sensors' weight and centrifugal force, stiffer the more they bend."""
    everywhere = rng.random() < 0.3
    chosen = range(scene.sensor_count) if everywhere else [draw_sensor(rng, scene)]
    weight = -scene.to_world[:, 2, :]
    rate = scene.motion.turning_rate(scene.time_s, scene.step_s / 50)
    bends = {}
    for sensor in chosen:
        arm = scene.positions_m[sensor]
        along = arm / norm(arm) if norm(arm) > 0 else draw_direction(rng)
        spin = 0.0 if scene.motion.kind == "turntable" else 1.0
        force = weight + spin * np.cross(np.cross(rate, arm), rate) / 9.81
        bend = np.cross(along, force) @ np.diag(rng.uniform(0.5, 1.5, 3))
        twist = np.outer(force @ draw_direction(rng), along) * rng.uniform(0, 0.6)
        bends[sensor] = (bend + twist) * (1 - rng.uniform(0, 0.15) * norm(bend, axis=1)[:, None] ** 2)

    def change(amplitude: float, _seen: object) -> tuple[FloatArray, FloatArray]:
        rows = {}
        for sensor, bend in bends.items():
            turned = scene.field_T[:, :, None]
            for axis, angle in zip("xyz", bend.T, strict=True):
                turned = about(axis, amplitude * angle) @ turned
            rows[sensor] = (turned[:, :, 0] - scene.field_T) @ scene.response[sensor].T
        return of_sensors(scene, rows)

    sensors = (ALL,) if everywhere else (chosen[0] + 1,)
    return Disturbance("flexure", sensors, (), change, "rad under one g", {})
