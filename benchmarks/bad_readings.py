"""Whether single bad readings are left out: ``python benchmarks/bad_readings.py --half judged``.

Each run is a sound recording of 1200 samples, turned slowly or put at random, of one to four sensors with 1 or 20 nT of
noise, stated or estimated. It is calibrated, then again with 0.1 to 10 % of its samples spoiled in one way, at random
times, in bursts, or every so many. A row tells how often that succeeded with at most 1.5 times the error of the field.
``sound`` tells the part of the sound recordings that lose a sample or are refused. The rules were made on the ways
``made`` and are judged on the others.
"""

from collections.abc import Callable
from dataclasses import replace

import click
import numpy as np
from numpy.random import Generator
from rich.progress import track
from spread import Row, show

from tam_calibration import read_scenario, simulate
from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray
from tam_calibration.simulation.conditions import RandomAttitudes, Tumble

SAMPLES, PARTS, FIELD_T = 1200, (0.001, 0.01, 0.03, 0.1), 50e-6
"""Two minutes at 10 Hz, spoiled from a single reading to a tenth, in a field of middle latitudes."""
MOTIONS = (Tumble(np.radians(40)), Tumble(np.radians(90)), RandomAttitudes())
ASKED, LARGEST = 0.95, 1.5
"""Part of the runs that are to succeed, and the ratio of the errors of the field up to which they do."""

Change = Callable[[FloatArray, Generator], FloatArray]
"""Makes bad readings (n, 3), tesla, of those of one sensor."""


def _bits(readings_T: FloatArray, rng: Generator) -> FloatArray:
    """Invert one bit of the reading in nanotesla."""
    axes = rng.integers(3, size=len(readings_T))
    counts = np.round(readings_T * 1e9).astype(np.int64)
    counts[np.arange(len(counts)), axes] ^= 1 << rng.integers(9, 16, size=len(counts))
    return counts * 1e-9


def _bytes(readings_T: FloatArray, rng: Generator) -> FloatArray:
    """Exchange the bytes of 16 bits of 2 nT."""
    return np.round(readings_T / 2e-9).astype(np.int16).byteswap() * 2e-9


MADE: dict[str, Change] = {
    "off by some µT": lambda readings_T, rng: readings_T + 2e-6 * rng.normal(size=3),
    "shrunk": lambda readings_T, rng: readings_T * rng.uniform(0.1, 0.9, (len(readings_T), 1)),
    "a sign": lambda readings_T, rng: readings_T * np.where(np.arange(3) == rng.integers(3), -1, 1),
    "overflow": lambda readings_T, rng: readings_T - 65.536e-6 * np.sign(readings_T) * [0, 1, 0],
    "least of 16 bits": lambda readings_T, rng: np.full_like(readings_T, -32768e-9),
    "600 nT": lambda readings_T, rng: np.add(readings_T, [600e-9, 0, 0]),
    "a bit": _bits,
    "axes exchanged": lambda readings_T, rng: readings_T[:, [1, 0, 2]],
    "an axis zero": lambda readings_T, rng: readings_T * np.where(np.arange(3) == rng.integers(3), 0, 1),
    "twice": lambda readings_T, rng: 2 * readings_T,
    "a byte short": lambda readings_T, rng: readings_T / 256,
    "of another time": lambda readings_T, rng: rng.permutation(readings_T),
    "heavy tails": lambda readings_T, rng: readings_T + 300e-9 * rng.standard_t(1, readings_T.shape),
    "99 999": lambda readings_T, rng: np.full_like(readings_T, 99_999e-9),
    "2 µT of a spark": lambda readings_T, rng: readings_T + 2e-6 * rng.choice([-1, 1], readings_T.shape),
    "bytes exchanged": _bytes,
    "half an axis": lambda readings_T, rng: readings_T * np.where(np.arange(3) == rng.integers(3), 0.5, 1),
    "axes rolled": lambda readings_T, rng: np.roll(readings_T, 1, axis=1),
    "clipped": lambda readings_T, rng: np.clip(readings_T, -15e-6, 15e-6),
    "in steps": lambda readings_T, rng: np.round(readings_T / 10e-6) * 10e-6,
    "a thousandth": lambda readings_T, rng: readings_T / 1000,
    "noise": lambda readings_T, rng: readings_T + 5e-6 * rng.normal(size=readings_T.shape),
    "a ramp": lambda readings_T, rng: readings_T + np.linspace(1e-6, 5e-6, len(readings_T))[:, None],
    "without sign": lambda readings_T, rng: np.abs(readings_T),
    "without their mean": lambda readings_T, rng: readings_T - readings_T.mean(axis=0),
    "all bits inverted": lambda readings_T, rng: -readings_T - 1e-9,
    "turned by 90°": lambda readings_T, rng: readings_T[:, [1, 0, 2]] * [-1, 1, 1],
    "x on all axes": lambda readings_T, rng: np.repeat(readings_T[:, :1], 3, axis=1),
    "a pulse that decays": lambda readings_T, rng: (
        readings_T + 10e-6 * np.exp(-np.arange(len(readings_T)) / 4)[:, None] * rng.choice([-1, 1], 3)
    ),
    "summed up": lambda readings_T, rng: np.cumsum(readings_T, axis=0) + readings_T[-1],
    "a byte of ones": lambda readings_T, rng: (np.round(readings_T * 1e9).astype(np.int32) | 0xFF00) * 1e-9,
    "half the range more": lambda readings_T, rng: readings_T + 32.768e-6 * (np.arange(3) == rng.integers(3)),
    "hum": lambda readings_T, rng: readings_T + 1.5e-6 * np.cos(np.pi * np.arange(len(readings_T)))[:, None],
    "1000 T": lambda readings_T, rng: np.where(np.arange(3) == rng.integers(3), 1e3, readings_T),
    "the middle of the range": lambda readings_T, rng: np.full_like(readings_T, 5e-6),
}
"""Ways on which the rules were made."""

JUDGED: dict[str, Change] = {
    "four times and wrapped": lambda readings_T, rng: (4 * readings_T + 32.768e-6) % 65.536e-6 - 32.768e-6,
    "an axis in gauss": lambda readings_T, rng: readings_T * np.where(np.arange(3) == rng.integers(3), 1e4, 1),
    "next to nothing": lambda readings_T, rng: readings_T * 1e-7,
    "an axis of the reading before": lambda readings_T, rng: np.column_stack(
        [np.roll(readings_T[:, 0], 1), readings_T[:, 1:]]
    ),
    "a thermometer for an axis": lambda readings_T, rng: np.where(
        np.arange(3) == rng.integers(3), 25e-6 + 20e-9 * rng.normal(size=(len(readings_T), 1)), readings_T
    ),
    "another site's field": lambda readings_T, rng: (
        np.array([0.0, 12e-6, -31e-6]) + 20e-9 * rng.normal(size=readings_T.shape)
    ),
    "squared": lambda readings_T, rng: readings_T * np.abs(readings_T) / FIELD_T,
    "a tenth": lambda readings_T, rng: readings_T / 10,
    "the last digits": lambda readings_T, rng: readings_T % 10e-6,
    "differences": lambda readings_T, rng: np.diff(readings_T, axis=0, append=readings_T[:1]),
}
"""Ways that were tried once, with the present rules."""


def recording_of(rng: Generator) -> tuple[Recording, Array, SensorErrors]:
    """Return a sound recording, its array and the true errors."""
    scenario = read_scenario("wu_table_1")
    motion = MOTIONS[rng.integers(len(MOTIONS))]
    noise_T, count = float(rng.choice([1e-9, 20e-9])), int(rng.choice([1, 3, 4, 4]))
    seed, cross = int(rng.integers(1 << 30)), Array.cross(0.5, noise_T, 1e-10)
    made = simulate(replace(scenario, array=cross, motion=motion, sample_count=SAMPLES, rate_hz=10.0, seed=seed))
    is_stated = rng.random() < 0.7 or isinstance(motion, RandomAttitudes)
    places = made.scenario.array.positions_m[:count]
    array = Array(places, np.full(count, noise_T), 1e-10) if is_stated else Array(places)
    recording = replace(made.recording, readings_T=made.recording.readings_T[:, :count])
    errors = SensorErrors.from_vector(made.errors.to_vector()[:count], made.errors.orientation[:count])
    return recording, array, errors


def spoiled(recording: Recording, change: Change, part: float, rng: Generator) -> Recording:
    """Return a recording of whose samples a part is bad, at random times, every so many, or in some bursts."""
    count = max(round(part * SAMPLES), 1)
    way = rng.integers(3)
    chosen: IntArray = np.sort(rng.choice(SAMPLES, count, replace=False))
    if way == 1:
        chosen = np.arange(0, SAMPLES, SAMPLES // count)
    elif way == 2:
        starts = rng.choice(SAMPLES, max(count // 10, 1), replace=False)
        chosen = np.unique(starts[:, None] + np.arange(min(count, 10)))
        chosen = chosen[chosen < SAMPLES]
    readings_T, sensor = recording.readings_T.copy(), rng.integers(recording.sensor_count)
    readings_T[chosen, sensor] = change(readings_T[chosen, sensor], rng)
    return replace(recording, readings_T=readings_T)


def deviation_of(calibration: Calibration, truth: SensorErrors) -> float:
    """Return the root mean square error of the corrected field over the sphere, tesla."""
    direction = np.random.default_rng(1).normal(size=(500, 3))
    field_T = FIELD_T * direction / np.linalg.norm(direction, axis=1, keepdims=True)
    unbiased_T = truth.distort(field_T) - calibration.errors.bias_T
    found_T = np.einsum("kij,nkj->nki", np.linalg.inv(calibration.errors.matrix), unbiased_T)
    return float(np.sqrt(((found_T - field_T[:, None]) ** 2).sum(axis=2).mean()))


def ratio_of(change: Change, rng: Generator) -> float:
    """Return the error of a calibration of a spoiled recording over that of the sound one; infinite if refused."""
    recording, array, errors = recording_of(rng)
    bad = spoiled(recording, change, float(rng.choice(PARTS)), rng)
    clean = deviation_of(calibrate(recording, array), errors)
    try:
        return deviation_of(calibrate(bad, array), errors) / clean
    except (InputError, Refused):
        return float("inf")


def is_lost(rng: Generator) -> bool:
    """Return whether a sound recording is refused, or loses a sample."""
    recording, array, _ = recording_of(rng)
    try:
        return calibrate(recording, array).samples < SAMPLES
    except (InputError, Refused):
        return True


@click.command(help=__doc__)
@click.option("--half", type=click.Choice(["made", "judged"]), required=True, help="Ways of the rules, or others.")
@click.option("--runs", default=30, show_default=True, help="Recordings of each way; of sound ones ten times as many.")
@click.option("--first-seed", default=1, show_default=True)
def main(half: str, runs: int, first_seed: int) -> None:
    """Print the table, and keep it."""
    ways, rows, all_ratios = MADE if half == "made" else JUDGED, [], []
    for place, (name, change) in enumerate(track(ways.items(), description=half)):
        seeds = ([first_seed, len(half), place, run] for run in range(runs))
        ratios = np.array([ratio_of(change, np.random.default_rng(seed)) for seed in seeds])
        all_ratios.append(ratios)
        rows.append(Row(f"{half}, {name}", "part within 1.5 times the error", [float((ratios <= LARGEST).mean())]))
    succeeded = float((np.concatenate(all_ratios) <= LARGEST).mean())
    rows.append(Row(f"{half}, all", "part within 1.5 times the error", [succeeded], least=ASKED))
    lost = [is_lost(np.random.default_rng([first_seed, run])) for run in track(range(10 * runs), description="sound")]
    rows.append(Row("sound", "part that loses a sample or is refused", [float(np.mean(lost))], most=0.01))
    command = f"python benchmarks/bad_readings.py --half {half} --runs {runs} --first-seed {first_seed}"
    show("Single bad readings", command, f"bad_readings_{half}.csv", rows)


if __name__ == "__main__":
    main()
