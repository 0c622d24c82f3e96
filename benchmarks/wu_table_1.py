"""Accuracy of the fits on Wu's Table 1, against the Cramér-Rao bound and the noise floor.

Run ``python benchmarks/wu_table_1.py [--runs 500]``. All methods see the same data. Three tables:

1. RMSE over bound of each group of parameters;
2. e_T over its floor on a second recording of 360 samples that the fit has not seen;
3. RMSE of the bias with a field drift of 8.26 nT that the scalar tracks, over that without drift.
"""

from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit.information import bound
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.published import lossless
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import measure_residuals
from tam_calibration.model.units import FloatArray, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Simulation, simulate
from tam_calibration.simulation.conditions import SinusoidDrift

DRIFT_T = 8.26e-9
"""Standard deviation of the drift of the field, as in ``docs/explanation/methods.md``."""

METHODS: dict[str, Callable[[Recording, Array], Calibration]] = {
    "maximum_likelihood": maximum_likelihood,
    "lossless": lossless,
    "lossless, step 1 as published": partial(lossless, as_published=True),
}
GROUPS = {
    "scale factor": slice(0, 3),
    "bias": slice(6, 9),
    "non-orthogonality": slice(3, 6),
    "misalignment": slice(9, 12),
}
RESULTS = Path(__file__).parent / "results" / "wu_table_1.csv"


@click.command(help=__doc__)
@click.option("--runs", default=500, show_default=True, help="Simulated recordings.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
def main(runs: int, first_seed: int) -> None:
    """Run the benchmark."""
    seeds = range(first_seed, first_seed + runs)
    with ProcessPoolExecutor() as pool:
        scores = list(track(pool.map(score, seeds, chunksize=5), total=runs, description=f"{runs} runs"))
    rows = [row for method in METHODS for row in summarize(method, [score[method] for score in scores])]
    show(rows, runs)
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/wu_table_1.py --runs {runs} --first-seed {first_seed}"
        lines = [f"# {command}", "method,figure,value,standard_error", *(",".join(map(str, row)) for row in rows)]
        path.write_text("\n".join(lines) + "\n")


def score(seed: int) -> dict[str, dict[str, FloatArray | float]]:
    """Return each method's errors, the bound and the tensor error on unseen data for one seed."""
    scenario = replace(read_scenario("wu_table_1"), seed=seed)
    period_s = scenario.sample_count / scenario.rate_hz / 3
    drifting = simulate(replace(scenario, drift=SinusoidDrift(DRIFT_T, period_s)))
    steady, unseen = simulate(scenario), simulate(replace(scenario, seed=-1 - seed & 0xFFFFFFFF))
    variance = np.diag(bound(steady.center_field_T, steady.errors, scenario.array.with_stated_noise(), has_scalar=True))
    return {
        name: {"bound": variance.reshape(4, 12)}
        | _score(method(steady.recording, scenario.array), steady, unseen)
        | {"drift": _error(method(drifting.recording, scenario.array), drifting)}
        for name, method in METHODS.items()
    }


def _error(calibration: Calibration, run: Simulation) -> FloatArray:
    return calibration.errors.to_vector() - run.errors.to_vector()


def _score(calibration: Calibration, run: Simulation, unseen: Simulation) -> dict[str, FloatArray | float]:
    array, recording = unseen.scenario.array, unseen.recording
    residual = measure_residuals(calibration.errors, array, recording, calibration.intensity_T).tensor_rmse_T_per_m
    floor = measure_residuals(run.errors, array, recording, calibration.intensity_T).tensor_rmse_T_per_m
    return {"error": _error(calibration, run), "tensor": residual, "tensor_floor": floor}


def summarize(method: str, scores: list[dict[str, FloatArray | float]]) -> list[tuple[str, str, float, float]]:
    """Return the rows (method, figure, value, standard error of the value)."""
    error, drift, smallest = (np.array([score[key] for score in scores]) for key in ("error", "drift", "bound"))
    rows = []
    for group, columns in GROUPS.items():
        sensors = slice(1, None) if group == "misalignment" else slice(None)
        squares = (error**2)[:, sensors, columns].mean(axis=(1, 2))
        rows.append(
            (method, f"RMSE/bound {group}", *_root_ratio(squares, smallest[:, sensors, columns].mean(axis=(1, 2))))
        )
    tensor, floor = (np.array([score[key] for score in scores]) ** 2 for key in ("tensor", "tensor_floor"))
    rows.append((method, "e_T/floor out of sample", *_root_ratio(tensor, floor)))
    steady_bias, drift_bias = ((values**2)[:, :, 6:9].mean(axis=(1, 2)) for values in (error, drift))
    rows.append((method, "bias RMSE [nT]", *_root_ratio(to_nanotesla(to_nanotesla(steady_bias)), np.ones(len(scores)))))
    rows.append((method, "bias RMSE with drift/without", *_root_ratio(drift_bias, steady_bias)))
    return rows


def _root_ratio(numerator: FloatArray, denominator: FloatArray) -> tuple[float, float]:
    """Return the root of the ratio of two means over the runs, and its standard error."""
    ratio = numerator.mean() / denominator.mean()
    scatter = np.std(numerator - ratio * denominator, ddof=1) / np.sqrt(len(numerator)) / denominator.mean()
    return float(np.sqrt(ratio)), float(scatter / (2 * np.sqrt(ratio)))


def show(rows: list[tuple[str, str, float, float]], runs: int) -> None:
    """Print the rows as one table."""
    table = Table(title=f"Wu 2025 Table 1, N = 360, 1 nT and 0.1 nT, {runs} runs")
    for column in ("figure", *METHODS):
        table.add_column(column, justify="left" if column == "figure" else "right")
    for figure in dict.fromkeys(row[1] for row in rows):
        values = {method: (value, spread) for method, name, value, spread in rows if name == figure}
        table.add_row(figure, *(f"{values[method][0]:.4f} ± {values[method][1]:.4f}" for method in METHODS))
    Console().print(table)


if __name__ == "__main__":
    main()
