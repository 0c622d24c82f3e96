"""What amplifiers, converters, clocks, buses and recorders do to readings and their times."""

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray
from scipy.signal import lfilter

from tam_calibration.model.units import FloatArray
from tam_validation.blind.disturbance import (
    ALL,
    SCALAR,
    Disturbance,
    Signal,
    by_axis,
    draw_axes,
    draw_sensor,
    in_one_sensor,
    named,
    numbers,
    of_sensors,
    proportional,
)
from tam_validation.blind.scene import Scene

LEAST_FLIPS = 8
"""Least number of changes: a gain with fewer counts as a step."""


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


_Index = NDArray[np.integer[Any]]

_MOST_STALE = 0.4
"""Largest part of the samples at which stale readings may begin."""

_MOST_LOST = 0.6
"""Largest part of the samples that may be lost."""


def stale_samples(rng: Generator, scene: Scene) -> Disturbance:
    """Let one sensor's packets come late: its last reading stands again, or a stretch runs some samples behind."""
    sensor = draw_sensor(rng, scene)
    behind = bool(rng.random() < 0.4)
    longest = int(rng.integers(8, 30)) if behind else int(rng.choice([1, 1, 2, 4]))
    lag = int(rng.integers(1, 4))
    lengths = rng.integers(1, longest + 1, scene.sample_count)
    chances = rng.random(scene.sample_count) * lengths.mean()
    index = np.arange(scene.sample_count)

    def change(amplitude: float, seen: Signal) -> Signal:
        stale = _covered(np.flatnonzero(chances < min(amplitude, _MOST_STALE)), lengths)
        source = np.where(stale, index - lag, index) if behind else np.where(stale, 0, index)
        source = np.maximum(source, 0) if behind else np.maximum.accumulate(source)
        reading = seen[0][:, sensor]
        return of_sensors(scene, {sensor: reading[source] - reading})

    parameters = {"behind_by": lag if behind else 0, "longest": longest}
    return Disturbance("stale_samples", (sensor + 1,), (), change, "of the samples", parameters, after_noise=True)


def _covered(starts: _Index, lengths: _Index) -> NDArray[np.bool_]:
    """Return which samples (N,) lie in the stretches that begin at some of them; never the first."""
    ends = np.minimum(starts + lengths[starts], len(lengths))
    steps = np.zeros(len(lengths) + 1)
    np.add.at(steps, starts, 1)
    np.add.at(steps, ends, -1)
    return np.asarray((np.cumsum(steps)[:-1] > 0) & (np.arange(len(lengths)) > 0))


def timing_jitter(rng: Generator, scene: Scene) -> Disturbance:
    """Let one sensor take its samples now a little before, now a little after the times that are written down."""
    sensor = draw_sensor(rng, scene)
    law = str(rng.choice(["normal", "uniform", "waits"]))
    draws = {
        "normal": rng.normal(size=scene.sample_count),
        "uniform": rng.uniform(-(3**0.5), 3**0.5, scene.sample_count),
        "waits": rng.exponential(size=scene.sample_count) - 1,
    }

    def change(amplitude: float, _seen: object) -> Signal:
        taken = scene.readings_at(scene.time_s + amplitude * draws[law])[:, sensor]
        return of_sensors(scene, {sensor: taken - scene.readings_T[:, sensor]})

    return Disturbance("timing_jitter", (sensor + 1,), (), change, "s", {"law": law})


def interpolated_samples(rng: Generator, scene: Scene) -> Disturbance:
    """Lose stretches of one sensor's samples, and let the recorder fill them with straight lines."""
    sensor = draw_sensor(rng, scene)
    count = max(3, int(scene.sample_count * rng.uniform(0.005, 0.03)))
    middles = rng.uniform(0, scene.sample_count, count)
    lengths = rng.gamma(4.0, 0.25, count)
    index = np.arange(scene.sample_count)

    def change(amplitude: float, seen: Signal) -> Signal:
        apart = np.abs(index[:, None] - middles) < amplitude * lengths / 2
        lost = apart.any(axis=1) & (index > 0) & (index < index[-1])
        reading = seen[0][:, sensor]
        if lost.mean() > _MOST_LOST:
            return of_sensors(scene, {})
        filled = np.stack([np.interp(index, index[~lost], one[~lost]) for one in reading.T], axis=1)
        return of_sensors(scene, {sensor: filled - reading})

    parameters = {"stretches": count}
    return Disturbance(
        "interpolated_samples", (sensor + 1,), (), change, "samples a stretch", parameters, after_noise=True
    )
