"""The calibration that is kept up to date during a mission: equality, cost, memory, false alarms, changes told.

Run ``python benchmarks/live.py [--hours 24] [--runs 50] [--first-seed 10000]``. A cross is calibrated ashore by a full
turn of 30 s, and dives: it turns round once in two minutes, now to one side and now to the other, with ±10° of pitch
and roll; 1 nT of noise in each axis, 0.1 nT in the scalar, 100 Hz. Measured are

- the largest difference of an error from the fit of prior and samples at once, in standard errors, when one bias is
  200 nT from the prior and nothing else changes;
- the processor's time for a sample, and its part of a core at 100 samples of four sensors in a second;
- alarms and memory of a clean mission, in which the sensors wander by the rates of the prior;
- how long it takes until a change of 1 nT in the bias of one sensor, in any direction, is suspected and told; how often
  the right sensor and its bias are named first, alone, and at all; the same of a scale factor and of an angle that
  change a reading by as much, of the biases of all sensors, and of a bias as large as the field.
"""

import resource
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.files.text_files import write_whole
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import Prior, prior_of
from tam_calibration.fit.problem import Known, posterior_of
from tam_calibration.live.live import Live
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees

RESULTS = Path(__file__).parent / "results" / "live.csv"
WORLD_T = np.array([12e-6, 18e-6, -45e-6])
"""A field of middle latitudes, east, north, up: 50 µT, 64° steep."""

RATE_HZ = 100.0
"""Of the samples, for which the processor's time and the detection are asked."""

ARRAY = Array.cross(0.5, vector_noise_T=1e-9, scalar_noise_T=1e-10).with_stated_noise()
"""The cross of Wu 2025, with the noise of a good fluxgate and of a scalar magnetometer."""

CHUNK_S = 60.0
"""Samples made at once, between which the sensors wander: memory stays small, and drifts of a day are finely cut."""

TURN_S = 120.0
"""Of a vehicle that turns round once, as survey vehicles do at the end of a line."""

TILT = from_degrees(10.0)
"""Largest pitch and roll: an underwater vehicle cannot turn over."""


def errors_of(generator: np.random.Generator) -> SensorErrors:
    """Return errors of the size of Wu 2025 Table 1."""
    misalignment = from_degrees(generator.uniform(-2, 2, (4, 3)))
    misalignment[0] = 0
    return SensorErrors(
        1 + generator.uniform(-0.02, 0.02, (4, 3)),
        from_degrees(generator.uniform(-1, 1, (4, 3))),
        generator.uniform(-900e-9, 900e-9, (4, 3)),
        misalignment,
    )


def rows_of(errors: SensorErrors, turns: Rotation, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Return the rows (N, 15) of samples, as `Live.add` takes them."""
    readings = errors.distort(turns.inv().apply(WORLD_T)).reshape(len(time_s), -1)
    readings += 1e-9 * generator.normal(size=readings.shape)
    scalar = np.linalg.norm(WORLD_T) + 1e-10 * generator.normal(size=len(time_s))
    return np.column_stack([time_s, readings, scalar, np.full(len(time_s), np.nan)])


def dive(errors: SensorErrors, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Return the rows of a vehicle that turns to and fro, with pitch and roll of its waves and of its control."""
    yaw = 3 * np.sin(2 * np.pi * time_s / (2.7 * TURN_S)) + 2 * np.pi * time_s / TURN_S
    pitch = TILT * (0.7 * np.sin(2 * np.pi * time_s / 7.3) + 0.3 * np.sin(2 * np.pi * time_s / 61.0))
    roll = TILT * (0.6 * np.sin(2 * np.pi * time_s / 5.1) + 0.4 * np.sin(2 * np.pi * time_s / 43.0))
    turns = Rotation.from_euler("ZYX", np.stack([yaw, pitch, roll], axis=1))
    return rows_of(errors, turns, time_s, generator)


def recording_of(rows: FloatArray) -> Recording:
    """Return the recording of rows."""
    return Recording(rows[:, 0], rows[:, 1:-2].reshape(len(rows), -1, 3), rows[:, -2])


def ashore(errors: SensorErrors, generator: np.random.Generator, rates: ChangeRates | None = None) -> Prior:
    """Return the calibration of a full turn of 30 s, a day old."""
    turns = Rotation.random(3000, random_state=generator)
    rows = rows_of(errors, turns, np.arange(3000) / RATE_HZ, generator)
    return prior_of(maximum_likelihood(recording_of(rows), ARRAY), None, None, rates)


def walked(errors: SensorErrors, elapsed_s: float, generator: np.random.Generator) -> SensorErrors:
    """Return errors after a random walk at the default rates."""
    deviation = np.sqrt(ChangeRates().variances(elapsed_s, 0.0))
    vector = errors.to_vector() + deviation * generator.normal(size=(4, 12))
    vector[0, 9:] = 0
    return SensorErrors.from_vector(vector)


def chunks(start_s: float, end_s: float) -> Iterator[FloatArray]:
    """Yield the times of samples, a minute at once."""
    for begin_s in np.arange(start_s, end_s, CHUNK_S):
        yield begin_s + np.arange(round(min(CHUNK_S, end_s - begin_s) * RATE_HZ)) / RATE_HZ


def add(live: Live, rows: FloatArray) -> float:
    """Feed rows as the node does, five at once, and return the processor's time, seconds."""
    begin_s = time.process_time()
    for index in range(0, len(rows), 5):
        live.add(rows[index : index + 5])
        live.news()
    return time.process_time() - begin_s


def equality(seed: int) -> list[tuple[str, float]]:
    """Return how far the recursion is from the fit of all samples, in standard errors."""
    generator = np.random.default_rng(seed)
    errors = errors_of(generator)
    prior = ashore(errors, generator, ChangeRates(*[0.0] * 8))
    variance = np.zeros((4, 12))
    variance[1, 6:9] = 1e-12 / 3
    prior = replace(prior, covariance=prior.covariance + np.diag(variance.ravel()))
    direction = generator.normal(size=3)
    errors.bias_T[1] += 200e-9 * direction / np.linalg.norm(direction)
    rows = np.concatenate([dive(errors, time_s, generator) for time_s in chunks(0, 600)])
    live = Live(prior, "learn")
    add(live, np.vstack([rows, rows[-1] + [1e3, *[0] * 14]]))
    batch = posterior_of(recording_of(rows), prior.calibration.array, Known(prior))
    now = live.state.recursion.now
    deviation = np.sqrt(np.diag(batch.covariance))
    free = deviation > 0
    difference = (now.errors.to_vector() - batch.errors.to_vector()).ravel()[free] / deviation[free]
    return [
        ("largest difference, standard errors", float(np.abs(difference).max())),
        ("rms difference over directions, standard errors", now.distance(batch.errors)),
        ("samples", float(len(rows))),
    ]


def clean(seed: int, hours: float) -> list[tuple[str, float]]:
    """Return what a mission in which nothing happens costs, and what it is told of."""
    generator = np.random.default_rng(seed)
    errors = errors_of(generator)
    live = Live(ashore(errors, generator), "learn")
    errors = walked(errors, DAY_S, generator)
    spent_s, samples, published = 0.0, 0, 0
    first_MB, memory_MB = 0.0, 0.0
    for time_s in chunks(0, 3600 * hours):
        errors = walked(errors, CHUNK_S, generator)
        rows = dive(errors, time_s, generator)
        before = live.state.published
        spent_s += add(live, rows)
        published += live.state.published is not before
        samples += len(rows)
        memory_MB = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        if samples == 10 * len(rows):
            first_MB = memory_MB
        if samples % (3600 * RATE_HZ) == 0:
            print(f"{samples / 3600 / RATE_HZ:.0f} h, {len(live.state.changes)} alarms", flush=True)
    now = live.state.recursion.now
    return [
        ("hours", samples / RATE_HZ / 3600),
        ("samples", float(samples)),
        ("false alarms", float(len(live.state.changes))),
        ("minutes with a new calibration", float(published)),
        ("processor's time, µs a sample", spent_s / samples * 1e6),
        ("percent of a core at 4 × 100 Hz", spent_s / samples * RATE_HZ * 100),
        ("memory after ten minutes, MB", first_MB),
        ("memory at the end, MB", memory_MB),
        ("distance from the truth at the end, standard errors", now.distance(errors)),
    ]


Vary = Callable[[SensorErrors, int, np.random.Generator], SensorErrors]


def of_bias(errors: SensorErrors, sensor: int, generator: np.random.Generator, size_T: float = 1e-9) -> SensorErrors:
    """Return errors of which the bias of a sensor has moved, by 1 nT."""
    direction = generator.normal(size=3)
    bias_T = errors.bias_T.copy()
    bias_T[sensor] += size_T * direction / np.linalg.norm(direction)
    return replace(errors, bias_T=bias_T)


def of_large_bias(errors: SensorErrors, sensor: int, generator: np.random.Generator) -> SensorErrors:
    """Return errors of which the bias of a sensor has moved by 1 to 100 µT, all orders of magnitude alike."""
    return of_bias(errors, sensor, generator, 10 ** generator.uniform(-6, -4))


def of_scale(errors: SensorErrors, sensor: int, generator: np.random.Generator) -> SensorErrors:
    """Return errors of which a scale factor has grown by 50 ppm."""
    scale = errors.scale_factor.copy()
    scale[sensor, generator.integers(3)] += 50e-6
    return replace(errors, scale_factor=scale)


def of_angle(errors: SensorErrors, sensor: int, generator: np.random.Generator) -> SensorErrors:
    """Return errors of which a sensor is turned by 50 µrad about an axis; sensor 1 holds the frame."""
    misalignment = errors.misalignment.copy()
    turned = misalignment[1:] if sensor == 0 else misalignment[[sensor]]
    turned[:, generator.integers(3)] += 50e-6
    misalignment[1:] = turned if sensor == 0 else misalignment[1:]
    misalignment[sensor] = misalignment[sensor] if sensor == 0 else turned[0]
    return replace(errors, misalignment=misalignment)


def of_all_biases(errors: SensorErrors, sensor: int, generator: np.random.Generator) -> SensorErrors:
    """Return errors of which all biases have moved by 1 nT, each in a direction of its own."""
    direction = generator.normal(size=(4, 3))
    return replace(errors, bias_T=errors.bias_T + 1e-9 * direction / np.linalg.norm(direction, axis=1, keepdims=True))


CHANGES: dict[str, tuple[Vary, str]] = {
    "bias of 1 nT": (of_bias, "bias"),
    "large bias, 1 to 100 µT": (of_large_bias, "bias"),
    "scale factor of 50 ppm": (of_scale, "scale factor"),
    "misalignment of 50 µrad": (of_angle, "misalignment"),
    "biases of all sensors": (of_all_biases, "biases"),
}


def change(vary: Vary, kind: str, seed: int) -> tuple[float, float, bool, bool, bool, bool]:
    """Return delays of suspicion and tale, and whether sensor and kind are right: first, alone, among those named."""
    generator = np.random.default_rng(seed)
    errors = errors_of(generator)
    live = Live(ashore(errors, generator), "learn")
    errors = walked(errors, DAY_S, generator)
    change_s, sensor = 40 + generator.uniform(0, 20), int(generator.integers(4))
    after, suspected_s = vary(errors, sensor, generator), np.nan
    for time_s in chunks(0, change_s + 40):
        parts = [dive(each, some, generator) for each, some in _parted(errors, after, time_s, change_s)]
        for part in np.array_split(np.concatenate(parts), len(time_s) // 50):
            add(live, part)
            delay_s = part[-1, 0] - change_s
            if live.is_suspicious and np.isnan(suspected_s):
                suspected_s = delay_s
            if live.state.changes:
                told = live.state.changes[0]
                is_sensor = told.sensor == (0 if kind == "biases" else sensor + 1)
                names = told.parameters
                return suspected_s, delay_s, is_sensor, names[0] == kind, names == (kind,), kind in names
    return suspected_s, np.inf, False, False, False, False


def _parted(
    errors: SensorErrors, after: SensorErrors, time_s: FloatArray, change_s: float
) -> Iterator[tuple[SensorErrors, FloatArray]]:
    for each, some in ((errors, time_s[time_s < change_s]), (after, time_s[time_s >= change_s])):
        if len(some):
            yield each, some


def changes(name: str, seeds: range) -> list[tuple[str, float]]:
    """Return delays and rates over runs."""
    scores = np.array([change(*CHANGES[name], seed) for seed in seeds], dtype=float)
    suspected, told = scores[:, 0], scores[:, 1]
    in_time = (told > 0) & (told <= 30)
    return [
        ("runs", float(len(scores))),
        ("alarms before the change", float(np.sum(told <= 0))),
        ("told within 30 s", float(np.mean(in_time))),
        ("first suspicion, median s", float(np.nanmedian(suspected))),
        ("told, median s", float(np.median(told))),
        ("told, longest s", float(np.max(told))),
        ("right sensor", float(np.mean(scores[:, 2]))),
        ("right errors first", float(np.mean(scores[:, 3]))),
        ("right errors alone", float(np.mean(scores[:, 4]))),
        ("right errors among those named", float(np.mean(scores[:, 5]))),
    ]


@click.command(help=__doc__)
@click.option("--hours", default=24.0, show_default=True, help="Length of the clean mission.")
@click.option("--runs", default=50, show_default=True, help="Runs of each change.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first run; below 1000 it was tuned.")
@click.option("--only", default="", help="The parts whose names have this in them; the others keep their rows.")
def main(hours: float, runs: int, first_seed: int, only: str) -> None:
    """Run the benchmark."""
    seeds = range(first_seed + 10, first_seed + 10 + runs)
    parts: dict[str, Callable[[], list[tuple[str, float]]]] = {
        "equality": partial(equality, first_seed),
        **{name: partial(changes, name, seeds) for name in CHANGES},
        "clean mission": partial(clean, first_seed + 1, hours),
    }
    for name in [name for name in parts if only in name]:
        figures = (f'"{name}","{figure}",{value:.4g}' for figure, value in parts[name]())
        lines = [f'"{name}","first seed",{first_seed}', *figures]
        print("\n".join(lines), flush=True)
        _keep(name, lines)


def _keep(name: str, lines: list[str]) -> None:
    """Write the rows of a part beside those of the others."""
    stored = RESULTS.read_text(encoding="utf-8").splitlines()[2:] if RESULTS.exists() else []
    others = [line for line in stored if not line.startswith(f'"{name}",')]
    command = "# python benchmarks/live.py --only CASE --first-seed …, with seed, runs and hours of the rows"
    with write_whole(RESULTS) as path:
        path.write_text("\n".join([command, "case,figure,value", *others, *lines]) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
