"""Calibration beside a data sheet: whether the standard errors of narrow turns hold, and those of the next turns.

Run ``python benchmarks/tolerances.py [--runs 40] [--seed 1]``. True errors are drawn from the tolerances, of one sensor
or of Wu's cross; a vehicle runs full circles with pitch and roll up to the tilt limit, 300 samples, 1 nT and 0.1 nT of
white noise. ``vehicle``: 5 %, 2°, 3 µT and 2°, a chip or a fluxgate beside iron; ``sheet``: 0.5 %, 0.5°, 50 nT and 1°.
A row counts the errors that are within the 95 % intervals, and tells the size of all combinations of the errors over
their standard errors: its root mean square is one where the covariance is right, and less where curvature, which no
covariance holds, makes it wide. ``3 then 3 then 10`` are turns of which each is the prior of the next.

``--real`` PATH, several times, and ``--array``: recordings of one sensor that was turned all round. Twelfths of each
are calibrated beside 3 %, 2°, 10 µT and 2°, and their errors compared with those of the calibration of the whole.
"""

from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import click
import numpy as np
from numpy.linalg import norm
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import calibrate
from tam_calibration.fit.prior import in_first_frame
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import ChangeRates, Tolerances
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings import read_array, read_recording
from tam_calibration.simulation.conditions import Manoeuvre
from tam_validation.blind.rates import WITHIN_95

RESULTS = Path(__file__).parent / "results" / "tolerances.csv"
STATED = {
    "vehicle": Tolerances(0.05, np.radians(2), 3e-6, np.radians(2)),
    "sheet": Tolerances(0.005, np.radians(0.5), 50e-9, np.radians(1)),
}
"""Errors of a chip or of a fluxgate beside iron, and those that a maker of fluxgates and a mounting by eye leave."""

TURNS_DEG = ((2,), (10,), (30,), (3, 3, 10))
"""Limits of pitch and roll, of one turn or of some in a row."""

WORLD_T = np.array([3e-6, 18e-6, -46e-6])
"""A field of middle latitudes, east, north, up."""

REAL, PARTS = Tolerances(0.03, np.radians(2), 10e-6, np.radians(2)), 12
"""Of recordings that others made, whose sensors had been calibrated by their maker."""

SAMPLES, STEP_S, PERIOD_S, NOISE_T = 300, 0.2, 60.0, 1e-9
"""A minute's full circle, sampled as often as an update of a mission is, with Wu's noise."""


def turn(errors: SensorErrors, tilt_deg: float, start_s: float, rng: np.random.Generator) -> Recording:
    """Return what sensors with errors read on full circles."""
    limit, time_s = np.radians(tilt_deg), STEP_S * np.arange(SAMPLES)
    attitudes = Manoeuvre(limit, limit, PERIOD_S).attitudes(time_s + rng.uniform(0, PERIOD_S), rng)
    field = Rotation.from_quat(attitudes).inv().apply(WORLD_T)
    readings = errors.distort(field)
    scalar = norm(field, axis=1) + rng.normal(0, NOISE_T / 10, SAMPLES)
    return Recording(start_s + time_s, readings + rng.normal(0, NOISE_T, readings.shape), scalar)


def calibrated(
    tolerances: Tolerances, sensors: int, turns_deg: tuple[int, ...], rng: np.random.Generator
) -> FloatArray:
    """Return the (2, M) errors, and their principal combinations, after some turns, over their standard errors."""
    drawn = rng.normal(size=(sensors, 12)) * np.sqrt(tolerances.variances())
    drawn[:, :3] += 1
    errors = SensorErrors.from_vector(drawn)
    positions = np.zeros((1, 3)) if sensors == 1 else Array.cross(0.5).positions_m
    steady = ChangeRates(*np.zeros(8))
    array = Array(positions, np.full(sensors, NOISE_T), NOISE_T / 10, tolerances=tolerances, change_rates=steady)
    calibration: Calibration | None = None
    for place, tilt_deg in enumerate(turns_deg):
        calibration = calibrate(turn(errors, tilt_deg, 1.7e9 + 1000 * place, rng), array, prior=calibration)
    assert calibration is not None and calibration.covariance is not None
    free = calibration.standard_errors.ravel() > 0
    off = (calibration.errors.to_vector() - in_first_frame(errors)[0].to_vector()).ravel()[free]
    return over_standard_errors(off, calibration.covariance[np.ix_(free, free)])


def rows(runs: int, seed: int) -> Iterator[tuple[str, ...]]:
    """Yield sensors, tolerances, turns, runs, refused, errors within 95 %, rms and largest of all combinations."""
    for sensors in (1, 4):
        for name, tolerances in STATED.items():
            for turns_deg in TURNS_DEG:
                found, refused = [], 0
                for run in range(runs):
                    rng = np.random.default_rng([seed, run, sensors, *turns_deg])
                    try:
                        found.append(calibrated(tolerances, sensors, turns_deg, rng))
                    except (InputError, Refused):
                        refused += 1
                turns = " then ".join(str(tilt) for tilt in turns_deg)
                yield (str(sensors), name, turns, str(runs), str(refused), *figures(found))


def real_rows(paths: tuple[Path, ...], array: Array) -> Iterator[tuple[str, ...]]:
    """Yield the row of each recording, in the same order."""
    beside = replace(array, tolerances=REAL)
    for path in paths:
        recording = read_recording(path)
        whole, bounds = calibrate(recording, array), np.linspace(0, recording.sample_count, PARTS + 1).astype(int)
        assert whole.covariance is not None
        found, refused = [], 0
        for start, stop in pairwise(bounds.tolist()):
            try:
                part = calibrate(recording.take(slice(start, stop)), beside)
            except (InputError, Refused):
                refused += 1
                continue
            assert part.covariance is not None
            off = (part.errors.to_vector() - whole.errors.to_vector())[0, :9]
            found.append(over_standard_errors(off, (part.covariance + whole.covariance)[:9, :9]))
        yield ("1", "3 %, 10 µT", path.stem, str(PARTS), str(refused), *figures(found))


def over_standard_errors(off: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the (2, M) errors, and their principal combinations, over their standard errors."""
    size = np.sqrt(np.diag(covariance))
    variances, axes = np.linalg.eigh(covariance / np.outer(size, size))
    return np.array([off / size, axes.T @ (off / size) / np.sqrt(variances)])


def figures(found: list[FloatArray]) -> tuple[str, str, str]:
    """Return the part of single errors within 95 %, and rms and largest of all combinations; dashes without any."""
    if not found:
        return "-", "-", "-"
    single, combined = np.stack(found, axis=1)
    within = f"{100 * np.mean(np.abs(single) < WITHIN_95):.1f}"
    return within, f"{np.sqrt(np.mean(combined**2)):.2f}", f"{np.abs(combined).max():.1f}"


@click.command(help=__doc__)
@click.option("--runs", default=40, show_default=True)
@click.option("--seed", default=1, show_default=True)
@click.option("--real", "paths", multiple=True, type=click.Path(path_type=Path, exists=True))
@click.option("--array", "array_path", type=click.Path(path_type=Path, exists=True))
def main(runs: int, seed: int, paths: tuple[Path, ...], array_path: Path | None) -> None:
    """Count, print and write the results; those of recordings are only printed."""
    header = ("sensors", "tolerances", "tilt_deg", "runs", "refused", "within_95_percent", "pull_rms", "largest_pull")
    table, found = Table(*header), []
    if array_path is not None:
        for row in real_rows(paths, read_array(array_path)):
            table.add_row(*row)
        Console(width=120).print(table)
        return
    for row in rows(runs, seed):
        table.add_row(*row)
        found.append(",".join(row))
    Console(width=120).print(table)
    with write_whole(RESULTS) as beside:
        command = f"python benchmarks/tolerances.py --runs {runs} --seed {seed}"
        beside.write_text("\n".join([f"# {command}", ",".join(header), *found, ""]), encoding="utf-8")


if __name__ == "__main__":
    main()
