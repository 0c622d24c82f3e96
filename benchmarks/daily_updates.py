"""How standard errors hold over daily updates of sensors that change faster than their rates say.

Run ``python benchmarks/daily_updates.py [--runs 20] [--first-seed 1]``.

A cross is calibrated by a full turn. Every day for ten days its errors change as random walks, faster than the default
rates say. A recording of 600 samples updates the calibration of the day before, by a full turn or one of ±10°. Counted
are the 95 % intervals of all errors of the last update that contain the truth, and how wide they are.
"""

import click
import numpy as np
from live import ARRAY, WORLD_T, errors_of
from numpy.linalg import norm
from numpy.random import Generator
from rich.progress import track
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.calibrate import calibrate
from tam_calibration.model.data_sheet import DAY_S, ChangeRates
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

DAYS, SAMPLES, BEGIN_S = 10, 600, 1.7e9
"""Updates, samples of each, and a date of the first, without which a day would be assumed between any two."""

KINDS = {name: np.array(part) for name, part in {"all errors": [1, 1, 1, 1], "biases": [0, 0, 1, 0]}.items()}
"""Which kinds of errors change faster, in the order of the errors of a sensor."""


def recording(rng: Generator, errors: SensorErrors, day: int, is_full: bool) -> Recording:
    """Return a recording of a day: all attitudes, or within ±10° with every heading."""
    if is_full:
        turns = Rotation.random(SAMPLES, random_state=rng)
    else:
        angles = np.column_stack([rng.uniform(0, 360, SAMPLES), *rng.uniform(-10, 10, (2, SAMPLES))])
        turns = Rotation.from_euler("ZYX", angles, degrees=True)
    readings_T = errors.distort(turns.inv().apply(WORLD_T))
    readings_T += ARRAY.vector_noise_T[:, None] * rng.normal(size=readings_T.shape)
    scalar_T = norm(WORLD_T) + ARRAY.scalar_noise_T * rng.normal(size=SAMPLES)
    return Recording(BEGIN_S + day * DAY_S + np.arange(SAMPLES) / 10, readings_T, scalar_T)


def walked(rng: Generator, errors: SensorErrors, times: FloatArray) -> SensorErrors:
    """Return the errors a day later; sensor 1 is the frame."""
    sizes = np.sqrt(ChangeRates().variances(DAY_S, 0.0)) * np.repeat(times, 3)
    change = sizes * rng.normal(size=(errors.sensor_count, 12))
    change[0, 9:] = 0
    return SensorErrors.from_vector((errors.to_vector() + change), errors.orientation)


def after_days(rng: Generator, times: FloatArray, is_full: bool) -> tuple[Calibration, SensorErrors]:
    """Return the last calibration, and the errors then."""
    errors = errors_of(rng)
    calibration = calibrate(recording(rng, errors, 0, True), ARRAY)
    for day in range(1, DAYS + 1):
        errors = walked(rng, errors, times)
        calibration = calibrate(recording(rng, errors, day, is_full), ARRAY, prior=calibration)
    return calibration, errors


def measured(first_seed: int, runs: int, times: FloatArray, is_full: bool) -> tuple[list[float], list[float], float]:
    """Return which part of the intervals contains the truth, the standard errors, and how often a change is named."""
    held, sizes, moved = [], [], 0
    for run in range(runs):
        calibration, errors = after_days(np.random.default_rng([first_seed, run]), times, is_full)
        free = calibration.standard_errors > 0
        off = (calibration.errors.to_vector() - errors.to_vector())[free] / calibration.standard_errors[free]
        held.append(float(np.mean(np.abs(off) < 1.96)))
        sizes.append(float(np.sqrt(np.mean(calibration.standard_errors[:, 6:9] ** 2))))
        moved += bool(calibration.update and calibration.update.moved)
    return held, sizes, moved / runs


@click.command(help=__doc__)
@click.option("--runs", default=20, show_default=True)
@click.option("--first-seed", default=1, show_default=True)
def main(runs: int, first_seed: int) -> None:
    """Print the table, and keep it."""
    rows = []
    cases = [
        (f"{name} {times:g} times, {'full turn' if is_full else '±10°'}", part, times, is_full)
        for is_full in (True, False)
        for name, part in KINDS.items()
        for times in (1.0, 3.0, 10.0)
        if name == "all errors" or times > 1
    ]
    for name, part, times, is_full in track(cases):
        held, sizes, moved = measured(first_seed, runs, 1 + (times - 1) * part, is_full)
        rows.append(Row(name, "95 % intervals that contain the truth", [float(np.mean(held))], least=0.93))
        rows.append(Row(name, "standard error of a bias, nT", np.array(sizes) * 1e9))
        rows.append(Row(name, "last updates in which a change is named", [moved]))
    command = f"python benchmarks/daily_updates.py --runs {runs} --first-seed {first_seed}"
    show("Daily updates of sensors that change faster than stated", command, "daily_updates.csv", rows)


if __name__ == "__main__":
    main()
