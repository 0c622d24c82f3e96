"""How near the fits come to the statistical limit, figure by figure beside what is asked of it.

Run ``python benchmarks/limit.py [--runs 2000]``. Wu's Table 1 throughout: 360 samples, 1 nT and 0.1 nT of noise. What
differs is stated by the case; an outlier adds normal errors of its size to all twelve readings of a sample. Figures:

- RMSE/bound of a group of parameters: each error over its own Cramér-Rao bound, that of data without outliers;
- the largest RMSE/bound of any single parameter: n runs scatter one by 1/√(2n), so that it takes 2000 of them;
- the part of all errors within the 95 % intervals that the standard errors tell, and the same of single parameters;
- the closed form, which starts maximum_likelihood, against its end, in standard errors;
- e_T over its floor on a second recording that the fit has not seen;
- the processor time of a fit, its covariance and residuals included.
"""

import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import click
import numpy as np
from asked import ANYTHING, Figure
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import METHODS
from tam_calibration.fit.ellipsoid import free_scale, normalize
from tam_calibration.fit.information import bound
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.problem import closed_form
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, Simulation, simulate
from tam_calibration.simulation.conditions import Manoeuvre, Motion

RESULTS = Path(__file__).parent / "results" / "limit.csv"
FREE = np.delete(np.arange(48), [9, 10, 11])
"""The parameters that a uniform field determines: not the misalignment of sensor 1."""
GROUPS = {
    name: np.flatnonzero(np.isin(FREE % 12, columns))
    for name, columns in {
        "scale factor": (0, 1, 2),
        "bias": (6, 7, 8),
        "non-orthogonality": (3, 4, 5),
        "misalignment": (9, 10, 11),
    }.items()
}
OUTLIERS_NT = (100.0, 1e3, 1e4)
"""Sizes of outliers: from what a passing tool adds to what a broken reading is."""

OUTLIER_SHARE = 0.05
"""Part of the samples that are outliers: far more than a sound driver lets through."""

WITHIN_95 = 1.959964
"""Standard deviations within which a normal distribution has 95 %."""

COVERAGE = (0.93, 0.97)
"""Part of the errors that intervals of 95 % shall hold."""


@dataclass(frozen=True)
class Case:
    """What differs between the cases: the data, the methods, and the RMSE/bound that is asked of each group."""

    most: dict[str, float]
    unasked: tuple[str, ...] = ()
    motion: Motion | None = None
    outlier_nT: float = 0.0
    noise_factors: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0)
    has_scalar: bool = True
    sample_count: int = 360

    @property
    def methods(self) -> tuple[str, ...]:
        """All methods that are run."""
        return (*self.most, *self.unasked)

    def scenario(self, seed: int) -> Scenario:
        """Return the scenario of one run."""
        scenario = read_scenario("wu_table_1")
        noise_T = scenario.array.vector_noise_T * np.array(self.noise_factors)
        array = replace(scenario.array, vector_noise_T=noise_T)
        motion = self.motion or scenario.motion
        return replace(scenario, array=array, motion=motion, sample_count=self.sample_count, seed=seed)


CASES = {
    "Table 1": Case(
        {"maximum_likelihood": 1.03, "robust": 1.05},
        unasked=tuple(name for name in METHODS if name not in ("maximum_likelihood", "robust")),
    ),
    "without scalar": Case({}, unasked=("maximum_likelihood", "robust", "lossless"), has_scalar=False),
    "±30° pitch and roll": Case(
        {"maximum_likelihood": 1.05}, motion=Manoeuvre(from_degrees(30.0), from_degrees(30.0), 60.0)
    ),
    "±10° pitch and roll, 30 nT, 10 000 samples": Case(
        {"maximum_likelihood": 1.05, "robust": 1.05},
        unasked=("lossless",),
        motion=Manoeuvre(from_degrees(10.0), from_degrees(10.0), 60.0),
        noise_factors=(30.0, 30.0, 30.0, 30.0),
        sample_count=10_000,
    ),
    "noise of sensor 2 × 5": Case({"maximum_likelihood": 1.05}, noise_factors=(1.0, 5.0, 1.0, 1.0)),
} | {f"5 % outliers of {size:g} nT": Case({"robust": 1.20}, outlier_nT=size) for size in OUTLIERS_NT}
"""What the fits meet: Wu's Table 1, and what a mission has otherwise."""

ASKED_COVERAGE = [
    (case, method) for case in ("Table 1", "without scalar") for method in CASES["without scalar"].methods
]


def score(case: Case, seed: int) -> dict[str, dict[str, FloatArray]]:
    """Return each method's 45 errors over bound and over what it tells, and its processor time [ms]."""
    run = simulate(case.scenario(seed))
    array, recording = run.scenario.array, _spoil(case, run)
    errors, field_T = run.errors, run.center_field_T
    if not case.has_scalar:
        scale = float(free_scale(errors.matrix))
        errors, field_T = SensorErrors.from_matrix(scale * errors.matrix, errors.bias_T), field_T / scale
    smallest = np.sqrt(np.diag(bound(field_T, errors, array.with_stated_noise(), case.has_scalar)))[FREE]
    scores = {}
    for name in case.methods:
        start = time.process_time()
        calibration = METHODS[name](recording, array)
        elapsed = time.process_time() - start
        error = (calibration.errors.to_vector() - errors.to_vector()).ravel()[FREE]
        told = calibration.standard_errors.ravel()[FREE]
        scores[name] = {"ratio": error / smallest, "told": error / told, "ms": np.array(1e3 * elapsed)}
    return scores


def _spoil(case: Case, run: Simulation) -> Recording:
    recording, generator = run.recording, np.random.default_rng([run.scenario.seed, 1])
    hit = generator.random(recording.sample_count) < OUTLIER_SHARE
    readings = recording.readings_T.copy()
    readings[hit] += from_nanotesla(case.outlier_nT) * generator.standard_normal((hit.sum(), 4, 3))
    return replace(recording, readings_T=readings, scalar_T=recording.scalar_T if case.has_scalar else None)


def score_closed_form(seed: int) -> FloatArray:
    """Return the 45 differences of the closed form to maximum_likelihood, in standard errors."""
    run = simulate(CASES["Table 1"].scenario(seed))
    array, data = run.scenario.array.with_stated_noise(), normalize(run.recording)
    matrix, bias = closed_form(data, array.vector_noise_T / data.radius_T, array.scalar_noise_T / data.radius_T)
    start = SensorErrors.from_matrix(matrix, data.origin_T + data.radius_T * bias)
    end = maximum_likelihood(run.recording, array)
    difference: FloatArray = (start.to_vector() - end.errors.to_vector()).ravel()[FREE]
    return difference / end.standard_errors.ravel()[FREE]


def score_unseen(seed: int) -> tuple[float, float]:
    """Return e_T² of a second recording, of maximum_likelihood and of the true errors."""
    scenario = CASES["Table 1"].scenario(seed)
    calibration = maximum_likelihood(simulate(scenario).recording, scenario.array)
    unseen = simulate(replace(scenario, seed=-1 - seed & 0xFFFFFFFF)).recording
    found, floor = (
        measure_residuals(errors, scenario.array, unseen, calibration.intensity_T).tensor_rmse_T_per_m ** 2
        for errors in (calibration.errors, scenario.errors)
    )
    return found, floor


def summarize(name: str, scores: list[dict[str, dict[str, FloatArray]]]) -> Iterable[Figure]:
    """Yield the figures of a case."""
    case = CASES[name]
    for method in case.methods:
        ratio, told, ms = (np.array([score[method][key] for score in scores]) for key in ("ratio", "told", "ms"))
        asked = (0.0, case.most[method]) if method in case.most else ANYTHING
        for group, columns in GROUPS.items():
            squares = np.mean(ratio[:, columns] ** 2, axis=1)
            yield Figure(name, method, f"{group}, RMSE/bound", *_root(squares), asked)
        single = [_root(column) for column in ratio.T**2]
        most = (0.0, 1.10) if (name, method) == ("Table 1", "maximum_likelihood") else ANYTHING
        yield Figure(name, method, "largest RMSE/bound of any parameter", *max(single), most)
        yield from _coverage(name, method, np.abs(told) < WITHIN_95)
        yield Figure(name, method, "processor time [ms]", float(np.median(ms)))


def _coverage(name: str, method: str, within: np.ndarray) -> Iterable[Figure]:
    asked = COVERAGE if (name, method) in ASKED_COVERAGE else ANYTHING
    each, single = within.mean(axis=1), within.mean(axis=0)
    yield Figure(name, method, "within 95 %", float(each.mean()), float(each.std(ddof=1) / np.sqrt(len(each))), asked)
    for what, value in (("lowest", float(single.min())), ("highest", float(single.max()))):
        spread = float(np.sqrt(value * (1 - value) / len(within)))
        yield Figure(name, method, f"within 95 %, {what} of any parameter", value, spread, asked)


def _root(squares: FloatArray) -> tuple[float, float]:
    """Return the root of the mean over the runs, and its standard error."""
    root = float(np.sqrt(squares.mean()))
    return root, float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2 * root))


def against_closed_form(differences: list[FloatArray]) -> Figure:
    """Return the figure of the closed form."""
    name = "largest difference to maximum_likelihood [standard errors]"
    return Figure("Table 1", "closed form", name, float(np.abs(differences).max()), asked=(0.0, 0.01))


def out_of_sample(squares: list[tuple[float, float]]) -> Figure:
    """Return the figure of unseen data."""
    found, floor = np.array(squares).T
    ratio = found.mean() / floor.mean()
    spread = np.std(found - ratio * floor, ddof=1) / np.sqrt(len(found)) / floor.mean()
    value, error = float(np.sqrt(ratio)), float(spread / (2 * np.sqrt(ratio)))
    return Figure("Table 1", "maximum_likelihood", "e_T/floor out of sample", value, error, (0.0, 1.006))


@click.command(help=__doc__)
@click.option("--runs", default=2000, show_default=True, help="Simulated recordings of each case.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
@click.option("--only", default="", help="The cases whose names have this in them; the others keep their rows.")
def main(runs: int, first_seed: int, only: str) -> None:
    """Run the benchmark."""
    seeds = range(first_seed, first_seed + runs)
    with ProcessPoolExecutor() as pool:

        def run(function: Callable[[int], Any], title: str) -> list[Any]:
            return list(track(pool.map(function, seeds, chunksize=10), total=runs, description=title))

        figures = []
        if only in "Table 1":
            figures.append(against_closed_form(run(score_closed_form, "closed form")))
            figures.append(out_of_sample(run(score_unseen, "unseen data")))
        chosen = [name for name in CASES if only in name]
        for name in chosen:
            figures += summarize(name, run(partial(score, CASES[name]), name))
    show(figures, runs)
    kept = RESULTS.read_text(encoding="utf-8").splitlines()[2:] if RESULTS.exists() else []
    kept = [line for line in kept if not line.startswith(tuple(f'"{name}"' for name in chosen))]
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/limit.py --runs {runs} --first-seed {first_seed}"
        header = "case,method,figure,value,standard_error,asked,met"
        path.write_text("\n".join([f"# {command}", header, *kept, *(figure.line for figure in figures)]) + "\n")


def show(figures: list[Figure], runs: int) -> None:
    """Print what is asked as one table, and all methods beside each other as another."""
    table = Table("case", "method", "figure", "measured", "asked", "met", title=f"The statistical limit, {runs} runs")
    for figure in figures:
        if figure.verdict:
            spread = "" if np.isnan(figure.standard_error) else f" ± {figure.standard_error:.4f}"
            measured = f"{figure.value:.4f}{spread}"
            table.add_row(figure.case, figure.method, figure.name, measured, figure.asked_in_words, figure.verdict)
    console = Console(width=160)
    console.print(table)
    every = [figure for figure in figures if figure.case == "Table 1" and figure.method in METHODS]
    if not every:
        return
    names = list(dict.fromkeys(figure.name for figure in every if figure.method == "integrated"))
    names = [name for name in names if "any parameter" not in name]
    beside = Table("method", *names, title=f"All methods, {runs} runs")
    for method in METHODS:
        values = {figure.name: figure.value for figure in every if figure.method == method}
        beside.add_row(method, *(f"{values[name]:.4g}" for name in names))
    console.print(beside)


if __name__ == "__main__":
    main()
