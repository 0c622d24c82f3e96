"""What a bus and a recorder do to the times of readings: packets late or lost, clocks that tremble."""

from typing import Any

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.blind.disturbance import Disturbance, Signal, draw_sensor, of_sensors
from tam_calibration.blind.scene import Scene

Index = NDArray[np.integer[Any]]

MOST_STALE = 0.4
"""Part of the samples at which something stale may begin: with more of it the recording is another one."""

MOST_LOST = 0.6
"""Part of the samples that may be lost: a recording with more of them is none."""


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
        stale = _covered(np.flatnonzero(chances < min(amplitude, MOST_STALE)), lengths)
        source = np.where(stale, index - lag, index) if behind else np.where(stale, 0, index)
        source = np.maximum(source, 0) if behind else np.maximum.accumulate(source)
        reading = seen[0][:, sensor]
        return of_sensors(scene, {sensor: reading[source] - reading})

    parameters = {"behind_by": lag if behind else 0, "longest": longest}
    return Disturbance("stale_samples", (sensor + 1,), (), change, "of the samples", parameters, after_noise=True)


def _covered(starts: Index, lengths: Index) -> NDArray[np.bool_]:
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
        if lost.mean() > MOST_LOST:
            return of_sensors(scene, {})
        filled = np.stack([np.interp(index, index[~lost], one[~lost]) for one in reading.T], axis=1)
        return of_sensors(scene, {sensor: filled - reading})

    parameters = {"stretches": count}
    return Disturbance(
        "interpolated_samples", (sensor + 1,), (), change, "samples a stretch", parameters, after_noise=True
    )
