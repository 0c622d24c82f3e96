"""Fits with a scalar magnetometer that is slower than the sensors: a reading every 5 s beside 10 or 100 Hz.

Run ``python benchmarks/slow_scalar.py [--runs 240]``. The same data are fitted in three ways: with the readings alone,
as samples without one count only among the sensors; with the intensity interpolated and its errors shared by the
samples between two readings, which is what maximum_likelihood does; and with them taken for each sample's own. Of
scale factors, non-orthogonality and biases (the misalignment needs no scalar) it prints

- RMSE over that of the readings alone;
- RMSE over the standard error that is told;
- the part of all errors within the 95 % intervals that are told.
"""

from concurrent.futures import ProcessPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from unittest.mock import patch

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table

from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import likelihood as module
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.reference import interpolate
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import Drift, ScalarReference, SinusoidDrift, Tumble

RESULTS = Path(__file__).parent / "results" / "slow_scalar.csv"
READING_EVERY_S = 5.0
"""Between two readings of the scalar: those of slow proton magnetometers."""

WITHIN_95 = 1.959964
"""Standard deviations of a normal variable between which 95 % lie."""


@dataclass(frozen=True)
class WalkDrift:
    """An intensity that wanders without aim, by 0.3 nT in a second and 2.3 nT in a minute."""

    seed: int

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the site field (3,) at times (N,): (N, 3), tesla."""
        step_T = 0.3e-9 * np.sqrt(time_s[1] - time_s[0])
        walk = np.cumsum(np.random.default_rng(self.seed).normal(0, step_T, len(time_s)))
        return np.outer(walk, site_field_T / np.linalg.norm(site_field_T))


@dataclass(frozen=True)
class OwnNoise:
    """The errors of an interpolated intensity as if each sample had its own."""

    variance: FloatArray

    def explained(self, weighted: FloatArray, precision: FloatArray) -> FloatArray:
        """Return Xᵀ D⁻¹ X - Xᵀ (D + variance)⁻¹ X from D⁻¹ X and the diagonal of D⁻¹."""
        return weighted.T @ (weighted * (self.variance / (1 + self.variance * precision))[:, None])


def _interpolate_as_own(time_s: FloatArray, scalar: FloatArray, noise: float) -> tuple[FloatArray, OwnNoise]:
    intensity, shared = interpolate(time_s, scalar, noise)
    return intensity, OwnNoise(shared.variance)


TREATMENTS: dict[str, AbstractContextManager[object]] = {
    "readings alone": patch.object(module, "is_worth_interpolating", lambda source: False),
    "interpolated": nullcontext(),
    "taken for independent": patch.object(module, "interpolate", _interpolate_as_own),
}
FAST, SLOW = Tumble(from_degrees(90.0)), Tumble(from_degrees(6.0))
"""Rates of turning at which the field changes much and little between two readings of the scalar."""
CASES = {
    "90°/s, steady field": (FAST, None, 10, 600),
    "6°/s, steady field": (SLOW, None, 10, 600),
    "6°/s, sinusoid of 12 nT in 120 s": (SLOW, "sinusoid", 10, 600),
    "6°/s, random walk of 0.3 nT/√s": (SLOW, "walk", 10, 600),
    "90°/s, random walk of 0.3 nT/√s": (FAST, "walk", 10, 600),
    "6°/s, steady field, 100 Hz": (SLOW, None, 100, 300),
}


def scenario_of(case: str, seed: int) -> Scenario:
    """Return a run of one of the cases; array, errors and noise are those of Wu's Table 1."""
    motion, kind, rate_hz, duration_s = CASES[case]
    drift: Drift | None = {None: None, "sinusoid": SinusoidDrift(8.26e-9, 120.0), "walk": WalkDrift(seed)}[kind]
    return replace(
        read_scenario("wu_table_1"),
        motion=motion,
        sample_count=rate_hz * duration_s,
        rate_hz=rate_hz,
        scalar=ScalarReference(rate_hz=1 / READING_EVERY_S),
        drift=drift,
        seed=seed,
    )


def score(case: str, seed: int) -> FloatArray:
    """Return the (3, 2, 36) errors and standard errors of each treatment, without misalignment."""
    run = simulate(scenario_of(case, seed))
    found = []
    for treatment in TREATMENTS.values():
        with treatment:
            calibration = maximum_likelihood(run.recording, run.scenario.array)
        error = calibration.errors.to_vector() - run.errors.to_vector()
        found.append([error[:, :9].ravel(), calibration.standard_errors[:, :9].ravel()])
    return np.array(found)


def summarize(case: str, scores: FloatArray) -> list[tuple[str, str, str, float, float]]:
    """Return the rows (case, treatment, figure, value, standard error of the value) of scores (runs, 3, 2, 36)."""
    error, told = scores[:, :, 0], scores[:, :, 1]
    alone = np.mean(error[:, 0] ** 2, axis=0)
    rows = []
    for index, treatment in enumerate(TREATMENTS):
        against_alone = np.mean(error[:, index] ** 2 / alone, axis=1)
        against_told = np.mean((error[:, index] / told[:, index]) ** 2, axis=1)
        within = np.mean(np.abs(error[:, index]) < WITHIN_95 * told[:, index], axis=1)
        rows.append((case, treatment, "RMSE/readings alone", *_root(against_alone)))
        rows.append((case, treatment, "RMSE/told", *_root(against_told)))
        rows.append((case, treatment, "within 95 %", within.mean(), within.std(ddof=1) / np.sqrt(len(within))))
    return rows


def _root(squares: FloatArray) -> tuple[float, float]:
    """Return the root of the mean over the runs, and its standard error."""
    root = float(np.sqrt(squares.mean()))
    return root, float(squares.std(ddof=1) / np.sqrt(len(squares)) / (2 * root))


@click.command(help=__doc__)
@click.option("--runs", default=240, show_default=True, help="Simulated recordings of each case.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
def main(runs: int, first_seed: int) -> None:
    """Run the benchmark."""
    rows = []
    with ProcessPoolExecutor() as pool:
        for case in CASES:
            results = pool.map(partial(score, case), range(first_seed, first_seed + runs), chunksize=5)
            rows += summarize(case, np.array(list(track(results, total=runs, description=case))))
    show(rows, runs)
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/slow_scalar.py --runs {runs} --first-seed {first_seed}"
        header = "case,treatment,figure,value,standard_error"
        lines = (",".join([*(f'"{part}"' for part in row[:3]), f"{row[3]:.6g},{row[4]:.2g}"]) for row in rows)
        path.write_text("\n".join([f"# {command}", header, *lines]) + "\n")


def show(rows: list[tuple[str, str, str, float, float]], runs: int) -> None:
    """Print the rows as one table."""
    figures = list(dict.fromkeys(row[2] for row in rows))
    table = Table("case", "treatment", *figures, title=f"A scalar reading every {READING_EVERY_S:.0f} s, {runs} runs")
    for case, treatment in dict.fromkeys(row[:2] for row in rows):
        values = [f"{row[3]:.3f} ± {row[4]:.3f}" for row in rows if row[:2] == (case, treatment)]
        table.add_row(case if treatment == "readings alone" else "", treatment, *values)
    Console(width=130).print(table)


if __name__ == "__main__":
    main()
