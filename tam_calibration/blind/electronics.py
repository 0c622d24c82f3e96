"""What an amplifier, a converter, a clock and a recorder do to a reading."""

import numpy as np
from numpy.random import Generator

from tam_calibration.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    Signal,
    by_axis,
    draw_axes,
    draw_sensor,
    named,
    of_sensors,
    proportional,
)
from tam_calibration.blind.scene import Scene


def nonlinearity(rng: Generator, scene: Scene) -> Disturbance:
    """Bend the transfer function: it saturates softly, the converter's codes are uneven, or it is a polynomial."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    full_T = np.abs(scene.readings_T[:, sensor]).max() * rng.uniform(1.0, 1.3)
    part = scene.readings_T[:, sensor] / full_T
    law = str(rng.choice(["tanh", "converter", "polynomial"]))
    if law == "tanh":
        steep = rng.uniform(0.8, 2.0, 3)
        bent = np.tanh(steep * (part + rng.uniform(-0.4, 0.4, 3))) / steep
    elif law == "converter":
        phase = rng.uniform(0, 2 * np.pi, 3)
        bent = np.cos(np.pi * part) * rng.normal(size=3) + 0.2 * np.sin(2 * np.pi * part + phase)
    else:
        bent = sum(rng.normal(size=3) / order * part**order for order in range(2, 7))
    size = rng.uniform(0.5, 1.5, 3) * mask
    change = proportional(of_sensors(scene, {sensor: 1e-9 * size * bent}))
    parameters = {"law": law, "full_scale_nT": float(full_T * 1e9)}
    return Disturbance("nonlinearity", (sensor + 1,), named(mask), change, "nT at full scale", parameters)


def time_skew(rng: Generator, scene: Scene) -> Disturbance:
    """One sensor's, or one axis's, clock is late or early: what it reads is what was there then."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.35)
    sign = rng.choice([-1.0, 1.0])

    def change(amplitude: float, _seen: object) -> Signal:
        then = scene.readings_at(scene.time_s - sign * amplitude)[:, sensor]
        return of_sensors(scene, {sensor: mask * (then - scene.readings_T[:, sensor])})

    parameters, delays = {"late": bool(sign > 0)}, by_axis(sensor, "delay", sign * mask)
    return Disturbance("time_skew", (sensor + 1,), named(mask), change, "s", parameters, coefficients=delays)


def quantization(rng: Generator, scene: Scene) -> Disturbance:
    """Convert in steps that are not small beside the noise: one sensor or axis, all alike, or the scalar."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    coarse = np.zeros((scene.sensor_count, 3))
    coarse[sensor] = mask
    sensors: tuple[int | str, ...] = (sensor + 1,)
    chance = rng.random()
    if scene.sensor_count > 1 and chance < 0.15:
        coarse, mask, sensors = np.ones_like(coarse), np.ones(3), (ALL,)
    scalar_too = scene.sensor_count > 1 and scene.with_scalar and chance > 0.9
    if scalar_too:
        coarse, mask, sensors = np.zeros_like(coarse), np.ones(3), (SCALAR,)
    trim = rng.uniform(0, 1, coarse.shape) if rng.random() < 0.5 else np.zeros(coarse.shape)

    def change(amplitude: float, seen: Signal) -> Signal:
        vectors, scalar = seen
        codes = np.round(vectors / amplitude - trim) + trim
        steps = amplitude * np.round(scalar / amplitude) - scalar
        return coarse * (codes * amplitude - vectors), scalar_too * steps

    parameters = {"trimmed": bool(trim.any())}
    return Disturbance("quantization", sensors, named(mask), change, "T a step", parameters, after_noise=True)


def saturation(rng: Generator, scene: Scene) -> Disturbance:
    """Clip an axis that cannot read more than its range, at one end or at both."""
    sensor, axis = draw_sensor(rng, scene), int(rng.integers(3))
    both = rng.random() < 0.4
    mask = np.eye(3)[axis]
    end = rng.choice([-1.0, 1.0])

    def change(amplitude: float, seen: Signal) -> Signal:
        reading = seen[0][:, sensor, axis]
        limit = (np.abs(reading) if both else end * reading).max() - amplitude
        clipped = np.clip(reading, -limit, limit) if both else end * np.minimum(end * reading, limit)
        return of_sensors(scene, {sensor: np.outer(clipped - reading, mask)})

    parameters = {"both_ends": bool(both)}
    return Disturbance(
        "saturation", (sensor + 1,), named(mask), change, "T over the range", parameters, after_noise=True
    )
