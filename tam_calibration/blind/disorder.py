"""What has no regular shape: tones of a machine, spikes, more noise than promised."""

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from tam_calibration.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    Signal,
    draw_axes,
    draw_sensor,
    named,
    numbers,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_calibration.blind.processes import draw_wander
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray

Place = tuple[tuple[int | str, ...], tuple[str, ...], Signal]


def periodic_interference(rng: Generator, scene: Scene) -> Disturbance:
    """Let a machine hum into one sensor or into all, with harmonics; its speed and strength waver a little."""
    frequency_hz = rng.uniform(0.12, 0.46) / scene.step_s
    slip = draw_wander(rng, scene.duration_s, 6)(scene.time_s) * rng.uniform(0, 0.4)
    strength = 1 + rng.uniform(0, 0.2) * draw_wander(rng, scene.duration_s, 8)(scene.time_s)
    overtones = rng.uniform(0, 0.3, 2)
    phase = (2 * np.pi * frequency_hz * scene.time_s + slip)[:, None]

    def hum(columns: int) -> FloatArray:
        shift = rng.uniform(0, 2 * np.pi, (3, columns))
        tones = np.sin(phase + shift[0]) + overtones[0] * np.sin(2 * phase + shift[1])
        tones = tones + overtones[1] * np.sin(3 * phase + shift[2])
        return np.asarray(strength[:, None] * rng.uniform(0.4, 1.5, columns) * tones)

    sensors, axes, signal = _put(rng, scene, hum, everywhere=0.2)
    parameters = {"frequency_hz": frequency_hz, "overtones": numbers(overtones)}
    return Disturbance("periodic_interference", sensors, axes, proportional(signal), "nT", parameters)


def outliers(rng: Generator, scene: Scene) -> Disturbance:
    """Spikes of very unlike size, one by one or in bursts."""
    count = max(4, int(scene.sample_count * 10 ** rng.uniform(-2.5, -1.7)))
    burst = int(rng.choice([1, 1, 1, 3, 5]))
    starts = rng.choice(scene.sample_count - burst, size=max(2, count // burst), replace=False)
    struck = np.unique(starts[:, None] + np.arange(burst))

    def spikes(columns: int) -> FloatArray:
        rows = np.zeros((scene.sample_count, columns))
        size = 1 + rng.pareto(3.0, (len(struck), columns))
        rows[struck] = rng.choice([-1.0, 1.0], size.shape) * np.minimum(size, 8)
        return rows

    sensors, axes, signal = _put(rng, scene, spikes, everywhere=0.1)
    parameters = {"samples_struck": len(struck), "burst": burst}
    return Disturbance("outliers", sensors, axes, proportional(signal), "nT of the least spike", parameters)


def noise_excess(rng: Generator, scene: Scene) -> Disturbance:
    """One sensor or one axis is noisier than promised: white, of low frequency, or in some spans only."""
    law = str(rng.choice(["white", "coloured", "in spans"]))
    slope = rng.uniform(0.3, 0.9)
    loud = 1 + 2 * (draw_wander(rng, scene.duration_s, 10)(scene.time_s) > 0.3)

    def noise(columns: int) -> FloatArray:
        rows = rng.normal(size=(scene.sample_count, columns))
        if law == "coloured":
            spectrum = np.fft.rfft(rows, axis=0)
            spectrum[1:] /= np.arange(1, len(spectrum))[:, None] ** (slope / 2)
            rows = np.fft.irfft(spectrum, scene.sample_count, axis=0)
        return np.asarray(rows * loud[:, None] if law == "in spans" else rows)

    sensors, axes, signal = _put(rng, scene, noise, everywhere=0.0)
    parameters = {"law": law, "slope": slope if law == "coloured" else 0.0}
    return Disturbance("noise_excess", sensors, axes, proportional(signal), "nT", parameters)


def _put(rng: Generator, scene: Scene, draw: Callable[[int], FloatArray], everywhere: float) -> Place:
    """Disturb all sensors by some chance, or the scalar, or one sensor, or one axis of it."""
    chance = rng.random()
    if scene.sensor_count > 1 and chance < everywhere:
        rows = {sensor: 1e-9 * draw(3) for sensor in range(scene.sensor_count)}
        return (ALL,), (), of_sensors(scene, rows)
    if scene.with_scalar and scene.sensor_count > 1 and chance > 0.88:
        return (SCALAR,), (), of_scalar(scene, 1e-9 * draw(1)[:, 0])
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    return (sensor + 1,), named(mask), of_sensors(scene, {sensor: 1e-9 * mask * draw(3)})
