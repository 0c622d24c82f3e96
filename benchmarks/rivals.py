"""The fits beside the ellipsoid fits of other packages: the same data, accuracy beside time.

Run ``python benchmarks/rivals.py``; ``.venv/bin/pip install -e '.[bench]'`` brings the others, and what is not
installed is left out and named. Three cases with fixed seeds: a cheap single sensor (hard iron of 20 µT, scale factors
off by a tenth, axes by 2°, 20 nT of noise), the four sensors of Wu 2025 Table 1, one by one, and these in a field that
drifts by 8.26 nT. Every fit gets the readings of one sensor, the intensities of the scalar magnetometer (0.1 nT) and
the noise. Ours follow the intensities, ``twostep_hsi`` uses their mean; the others leave the scale open, and are
given the one that makes the mean intensity right.

All results are taken to one form. Bias, scale factors and axes (non-orthogonality): RMS errors over the Cramér-Rao
bound. ``|B|``: RMS difference from the true intensity on samples that no fit has seen. e_T: the gradient tensor that
the four sensors then show where there is none; fits of single sensors leave each in a frame of its own, so that the
last row, the fit of all at once, is what an array needs. Times are CPU times a sensor; the calls take turns.

Not here: ``imucal`` calibrates accelerometers and gyroscopes, ``ahrs`` holds no calibration, ``magyc`` needs numpy 1
and has the methods of its authors' ``navlib``, ``pywayne`` and ``qmt`` need an accelerometer and a gyroscope beside
the magnetometer.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from time import process_time
from typing import TypeVar

import click
import numpy as np
from numpy.linalg import inv, norm
from rich.console import Console
from rich.progress import track
from rich.table import Table
from rival_fits import OURS, RIVALS, Correction, Data, Fit, array_of, is_installed
from spread import Row, save

from tam_calibration.fit import maximum_likelihood
from tam_calibration.fit.information import bound
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, Simulation, simulate
from tam_calibration.simulation.conditions import SinusoidDrift

Result = TypeVar("Result")

SAMPLES = 1000
FIRST_SEED = 20_000
DRIFT_T = 8.26e-9
"""Of a calm day, as in docs/explanation/methods.md."""
GROUPS = {"bias": slice(6, 9), "scale": slice(0, 3), "axes": slice(3, 6)}
TOGETHER = "maximum_likelihood, all at once"
TIMES, RESAMPLES = ("time, ms", "time/ours"), 500
CHEAP = SensorErrors(
    np.array([[1.1, 0.93, 1.04]]),
    np.radians([[2.0, -1.2, 1.6]]),
    np.array([[20e-6, -12e-6, 8e-6]]),
    np.zeros((1, 3)),
)
"""Ten percent of scale, two degrees and tens of µT: what a compass chip has."""
FIGURES = ("bias, nT", *(f"{group}/bound" for group in GROUPS), "|B|, nT", "e_T, nT/m", *TIMES)


@click.command(help=__doc__)
@click.option("--runs", default=50, show_default=True, help="Simulated recordings of each case.")
def main(runs: int) -> None:
    """Run the benchmark."""
    fits = OURS | {rival: fit for rival, (_, fit) in RIVALS.items() if is_installed(rival)}
    for module in sorted({module for rival, (module, _) in RIVALS.items() if not is_installed(rival)}):
        click.echo(f"{module} is not installed and left out: .venv/bin/pip install -e '.[bench]'", err=True)
    rows: list[Row] = []
    for case, scenario in cases().items():
        scores: dict[str, list[dict[str, float]]] = {}
        for seed in track(range(FIRST_SEED, FIRST_SEED + runs), description=case):
            for method, score in compare(replace(scenario, seed=seed), fits):
                scores.setdefault(method, []).append(score)
        of_case = [
            Row(case, f"{method}: {figure}", over_runs(figure, [score[figure] for score in each]))
            for method, each in scores.items()
            for figure in FIGURES
            if figure in each[0]
        ]
        show(case, list(scores), of_case)
        rows += of_case
    save(f"python benchmarks/rivals.py --runs {runs}", "rivals.csv", rows)


def over_runs(figure: str, values: list[float]) -> FloatArray:
    """Return the times of the runs; of errors their root mean square over runs that are drawn again and again."""
    if figure in TIMES:
        return np.array(values)
    drawn = np.random.default_rng(0).integers(len(values), size=(RESAMPLES, len(values)))
    return np.asarray(np.sqrt((np.array(values)[drawn] ** 2).mean(axis=1)))


def cases() -> dict[str, Scenario]:
    """Return what is simulated, but for the seed."""
    cross = replace(read_scenario("wu_table_1"), sample_count=SAMPLES)
    single = Array(np.zeros((1, 3)), np.array([20e-9]), 0.1e-9)
    drift = SinusoidDrift(DRIFT_T, SAMPLES / cross.rate_hz / 3)
    return {
        "a cheap single sensor": replace(cross, array=single, errors=CHEAP),
        "cross array, Wu 2025 Table 1": cross,
        "the same in a field that drifts": replace(cross, drift=drift),
    }


def compare(scenario: Scenario, fits: dict[str, Fit]) -> Iterator[tuple[str, dict[str, float]]]:
    """Yield the figures of each fit in one run; a fit that fails gives none."""
    run, unseen = simulate(scenario), simulate(replace(scenario, seed=scenario.seed + 1_000_000))
    data = [data_of(run, sensor) for sensor in range(scenario.array.sensor_count)]
    timed = {method: each_alone(fit, data) for method, fit in fits.items()}
    if len(data) > 1:
        timed[TOGETHER] = all_at_once(run)
    unit = timed["maximum_likelihood"][0]
    for method, (seconds, corrections) in timed.items():
        score = figures(corrections, run, unseen)
        yield method, score | {"time, ms": 1e3 * seconds / len(data), "time/ours": seconds / unit}


def data_of(run: Simulation, sensor: int) -> Data:
    """Return what the fits of one sensor get."""
    array, recording = run.scenario.array, run.recording
    assert array.vector_noise_T is not None
    assert array.scalar_noise_T is not None
    assert recording.scalar_T is not None
    readings = np.ascontiguousarray(recording.readings_T[:, sensor])
    return Data(readings, recording.scalar_T, float(array.vector_noise_T[sensor]), array.scalar_noise_T)


def each_alone(fit: Fit, data: list[Data]) -> tuple[float, list[Correction]]:
    """Return the CPU time of a fit of all sensors one by one, and what it found."""
    seconds, found = timed_call(lambda: [fit(each) for each in data])
    return seconds, [correction.with_mean(each) for correction, each in zip(found, data, strict=True)]


def all_at_once(run: Simulation) -> tuple[float, list[Correction]]:
    """Return the same of our fit of the whole array."""
    seconds, errors = timed_call(lambda: maximum_likelihood.estimate(run.recording, run.scenario.array))
    return seconds, [Correction(inv(matrix), bias) for matrix, bias in zip(errors.matrix, errors.bias_T, strict=True)]


def timed_call(call: Callable[[], Result]) -> tuple[float, Result]:
    """Return the CPU time of a call, and what it returned."""
    begin = process_time()
    result = call()
    return process_time() - begin, result


def figures(corrections: list[Correction], run: Simulation, unseen: Simulation) -> dict[str, float]:
    """Return the figures of the corrections of all sensors."""
    array, truth = run.scenario.array, run.errors.to_vector()
    error = np.concatenate([each.errors.to_vector() for each in corrections]) - truth
    smallest = np.stack([bound_of(run, sensor) for sensor in range(len(corrections))])
    fields = np.stack(
        [each.field_T(unseen.recording.readings_T[:, sensor]) for sensor, each in enumerate(corrections)], axis=1
    )
    intensity = norm(unseen.center_field_T, axis=1)
    found = {"bias, nT": to_nanotesla(root_mean_square(error[:, GROUPS["bias"]]))}
    for group, columns in GROUPS.items():
        found[f"{group}/bound"] = root_mean_square(error[:, columns]) / smallest[:, columns].mean() ** 0.5
    found["|B|, nT"] = to_nanotesla(root_mean_square(norm(fields, axis=2) - intensity[:, None]))
    if array.has_gradient:
        tensor = fields.reshape(len(fields), -1) @ array.operator[3:8].T
        found["e_T, nT/m"] = to_nanotesla(float(norm(np.sqrt((tensor**2).mean(axis=0)))))
    return found


def bound_of(run: Simulation, sensor: int) -> FloatArray:
    """Return the (12,) smallest variances of a sensor that is calibrated alone."""
    alone = SensorErrors.from_vector(run.errors.to_vector()[sensor])
    alone.misalignment[:] = 0
    array = array_of(data_of(run, sensor)).with_stated_noise()
    return np.diag(bound(run.center_field_T, alone, array, has_scalar=True))


def root_mean_square(values: FloatArray) -> float:
    """Return the root of the mean square of all values."""
    return float(np.sqrt((values**2).mean()))


def show(case: str, methods: list[str], rows: list[Row]) -> None:
    """Print the medians, a method in a line."""
    medians = {row.figure: f"{row.quantiles[0]:.3g}" for row in rows}
    table = Table("method", *FIGURES, title=f"{case}, {SAMPLES} samples")
    for method in methods:
        table.add_row(method, *(medians.get(f"{method}: {figure}", "") for figure in FIGURES))
    Console(width=140).print(table)


if __name__ == "__main__":
    main()
