"""What has no regular shape: offsets that step, tones of a machine, spikes, more noise than promised."""

from collections.abc import Callable

import numpy as np
from numpy.linalg import norm
from numpy.random import Generator

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    Signal,
    by_axis,
    draw_axes,
    draw_direction,
    draw_sensor,
    named,
    numbers,
    of_scalar,
    of_sensors,
    proportional,
)
from tam_validation.blind.processes import draw_wander
from tam_validation.blind.scene import Scene
from tam_validation.blind.surroundings import dipole


def bias_jump(rng: Generator, scene: Scene) -> Disturbance:
    """Let an offset step, once, or there and back, or again."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.3)
    times_s = _times(rng, scene.duration_s)
    on = np.searchsorted(times_s, scene.time_s) % 2.0
    parameters, steps = {"times_s": numbers(times_s), "magnet": False}, dict[str, float]()
    if mask.all() and scene.sensor_count > 1 and rng.random() < 0.5:
        parameters["magnet"] = True
        signal = _magnet(rng, scene, sensor, on)
    else:
        step = mask * rng.normal(size=3)
        signal = of_sensors(scene, {sensor: 1e-9 * np.outer(on, step)})
        # A third step may have another size to who does not know that it is there and back.
        steps = by_axis(sensor, "offset", step) if len(times_s) <= 2 else {}
    change = proportional(signal)
    return Disturbance(
        "bias_jump", (sensor + 1,), named(mask), change, "nT of the step", parameters, coefficients=steps
    )


def _times(rng: Generator, duration_s: float) -> FloatArray:
    """Draw when it steps: well inside the recording and well apart."""
    count = int(rng.choice([1, 1, 2, 2, 3]))
    while True:
        share = np.sort(rng.uniform(0.12, 0.88, count))
        if count == 1 or np.diff(share).min() > 0.12:
            return share * duration_s


def _magnet(rng: Generator, scene: Scene, sensor: int, on: FloatArray) -> Signal:
    """Put a small magnet at one sensor; the others and the scalar at the centre see little of it."""
    others = np.delete(scene.positions_m, sensor, axis=0) - scene.positions_m[sensor]
    place = scene.positions_m[sensor] + rng.uniform(0.08, 0.15) * norm(others, axis=1).min() * draw_direction(rng)
    moment = draw_direction(rng)
    extra = dipole(moment, np.vstack([scene.positions_m, np.zeros(3)]) - place)
    extra *= 1e-9 / norm(extra[sensor])
    vectors = scene.through(on[:, None, None] * extra[:-1])
    return vectors, on * (scene.field_T @ extra[-1]) / scene.intensity_T


_Place = tuple[tuple[int | str, ...], tuple[str, ...], Signal]


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


def _put(rng: Generator, scene: Scene, draw: Callable[[int], FloatArray], everywhere: float) -> _Place:
    """Disturb all sensors by some chance, or the scalar, or one sensor, or one axis of it."""
    chance = rng.random()
    if scene.sensor_count > 1 and chance < everywhere:
        rows = {sensor: 1e-9 * draw(3) for sensor in range(scene.sensor_count)}
        return (ALL,), (), of_sensors(scene, rows)
    if scene.with_scalar and scene.sensor_count > 1 and chance > 0.88:
        return (SCALAR,), (), of_scalar(scene, 1e-9 * draw(1)[:, 0])
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    return (sensor + 1,), named(mask), of_sensors(scene, {sensor: 1e-9 * mask * draw(3)})
