"""What stands between a core and its converter: gains that switch or step, channels that leak, filters that ring."""

import numpy as np
from numpy.random import Generator
from scipy.signal import lfilter

from tam_calibration.blind.disturbance import (
    Disturbance,
    draw_axes,
    draw_sensor,
    in_one_sensor,
    numbers,
)
from tam_calibration.blind.scene import Scene
from tam_calibration.units import FloatArray

LEAST_FLIPS = 8
"""A gain that changes less often steps."""


def gain_switching(rng: Generator, scene: Scene) -> Disturbance:
    """Let an amplifier go to another range and back, at any time or in short bursts, with the offset behind it."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    bursts = bool(rng.random() < 0.5)
    high = _bursts(rng, scene) if bursts else _telegraph(rng, scene)
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * high[:, None] * _output(scene, sensor)
    parameters = {"bursts": bursts, "share": float(high.mean())}
    return in_one_sensor(scene, "gain_switching", sensor, mask, change, parameters)


def _output(scene: Scene, sensor: int) -> FloatArray:
    """Return the reading (N, 3) with its bias, as a share of the intensity."""
    return np.asarray(scene.readings_T[:, sensor] / scene.intensity_T.mean())


def _bursts(rng: Generator, scene: Scene) -> FloatArray:
    """Return where it is on (N,): stretches of a hundredth of the recording or so."""
    count = int(rng.integers(LEAST_FLIPS, 20))
    starts_s = rng.uniform(0, 0.97 * scene.duration_s, count)
    ends_s = starts_s + scene.duration_s * rng.uniform(0.006, 0.03, count)
    since, until = scene.time_s[:, None] >= starts_s, scene.time_s[:, None] < ends_s
    return np.asarray((since & until).any(axis=1), dtype=float)


def _telegraph(rng: Generator, scene: Scene) -> FloatArray:
    """Return which of two states (N,) it is in, each left after a time without memory."""
    mean_s = scene.duration_s / rng.uniform(12, 40)
    flips_s = np.cumsum(rng.exponential(mean_s * rng.uniform(0.5, 1.5, 2), (60, 2)).ravel())
    flips_s = np.concatenate([flips_s[flips_s < scene.duration_s], rng.uniform(0, scene.duration_s, 2)])
    missing = rng.uniform(0, scene.duration_s, max(0, LEAST_FLIPS - len(flips_s)))
    return np.asarray(np.searchsorted(np.sort(np.append(flips_s, missing)), scene.time_s) % 2, dtype=float)


def scale_step(rng: Generator, scene: Scene) -> Disturbance:
    """Let a resistor crack: the gain steps, once or twice, the offset behind it too."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.5)
    first = rng.uniform(0.15, 0.85)
    share = np.array([first] if rng.random() < 0.6 else [first, (first + rng.uniform(0.2, 0.6)) % 1])
    times_s = np.sort(share) * scene.duration_s
    levels = np.concatenate([np.zeros((1, 3)), rng.choice([-1.0, 1.0], (2, 3)) * rng.uniform(0.5, 1.5, (2, 3))])
    gains = mask * levels[np.searchsorted(times_s, scene.time_s)]
    change = 1e-9 * gains * _output(scene, sensor)
    return in_one_sensor(scene, "scale_step", sensor, mask, change, {"times_s": numbers(times_s)})


def crosstalk(rng: Generator, scene: Scene) -> Disturbance:
    """Let one channel leak into an axis of another sensor.

    A leak that is always there and in time is a misalignment, and one of a parallel axis is a gain. This one is there
    while the multiplexer hurries, or it is always there and comes some samples late.
    """
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.6)
    other = int(rng.choice([k for k in range(scene.sensor_count) if k != sensor] or [sensor]))
    leaking = int(rng.choice(np.flatnonzero(~mask.astype(bool)) if mask.sum() < 3 else 3))
    hurried = scene.motion.kind == "turntable" or rng.random() < 0.6
    late_s = scene.step_s * (rng.uniform(0, 1) if hurried else rng.uniform(3, 10))
    source = scene.readings_at(scene.time_s - late_s)[:, other, leaking] / scene.intensity_T.mean()
    on = _telegraph(rng, scene) if hurried else np.ones(scene.sample_count)
    change = 1e-9 * np.outer(on * source, mask * rng.uniform(0.4, 1.4, 3))
    parameters = {"from": other + 1, "late_s": late_s, "hurried": hurried}
    return in_one_sensor(scene, "crosstalk", sensor, mask, change, parameters)


def ringing(rng: Generator, scene: Scene) -> Disturbance:
    """Let a filter ring after each step of the field: a damped oscillation that dies within some samples."""
    sensor, mask = draw_sensor(rng, scene), draw_axes(rng, 0.4)
    cycles, decay = rng.uniform(0.08, 0.42), np.exp(-1 / rng.uniform(1.5, 6))
    pole = decay * np.exp(2j * np.pi * cycles)
    core = scene.core(sensor)
    steps = np.diff(core, axis=0, prepend=core[:1])
    tail = lfilter([1.0], [1.0, -pole], steps.astype(complex), axis=0) * np.exp(1j * rng.uniform(0, 2 * np.pi))
    change = 1e-9 * mask * rng.uniform(0.6, 1.4, 3) * tail.real
    parameters = {"frequency_hz": cycles / scene.step_s, "decay_s": float(-scene.step_s / np.log(decay))}
    return in_one_sensor(scene, "ringing", sensor, mask, change, parameters)
