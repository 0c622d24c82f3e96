"""Fits at a site whose field has a gradient, with attitude recorded.

Run ``python benchmarks/ambient_gradient.py [--runs 240]``. Array, errors, noise and number of samples are those of Wu's
Table 1, the gradient has the Frobenius norm that is named, the scalar magnetometer sits at the centre or 0.97 m away.
For each case it prints

- RMSE of each group over the bound in a uniform field, the same attitudes with the scalar at the centre;
- the part of all parameters' errors within the 95 % intervals that are told, and the same of the gradient's;
- RMSE of the gradient's components.

Attitude errors are 1° of noise about each axis, and an instrument mounted turned by 1°; the fit aligns attitudes
with the field, and does not know of them otherwise.
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import click
import numpy as np
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from tam_calibration.files.text_files import write_whole
from tam_calibration.fit.information import bound
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre, Motion, RandomAttitudes

RESULTS = Path(__file__).parent / "results" / "ambient_gradient.csv"
SHAPE = np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])
AWAY_M = np.array([0.3, -0.2, 0.9])
"""Where the scalar magnetometer is in some cases: a metre away, along no axis."""

MOUNT = np.array([0.6, -0.64, 0.48])
"""Unit vector about which the array is mounted wrong in some cases: along no axis."""

GROUPS = {
    "scale factor": slice(0, 3),
    "bias": slice(6, 9),
    "non-orthogonality": slice(3, 6),
    "misalignment": slice(9, 12),
}
COMPONENTS = ("gradient xx", "gradient xy", "gradient xz", "gradient yy", "gradient yz")
WITHIN_95 = 1.959964
"""Standard deviations of a normal variable between which 95 % lie."""

SPHERE, VEHICLE = RandomAttitudes(), Manoeuvre(from_degrees(30.0), from_degrees(30.0), 60.0)
"""All attitudes, and those that a vehicle reaches: 30° of roll and pitch in a turn of a minute."""

Row = tuple[str, str, float, float]


@dataclass(frozen=True)
class Case:
    """What differs between the cases."""

    motion: Motion
    gradient_nT_per_m: float
    is_fitted: bool = True
    attitude_error_deg: float = 0.0
    scalar_is_away: bool = False


CASES = {
    "all attitudes, uniform": Case(SPHERE, 0.0, is_fitted=False),
    "all attitudes, 100 nT/m, not fitted": Case(SPHERE, 100.0, is_fitted=False),
    "all attitudes, 100 nT/m": Case(SPHERE, 100.0),
    "all attitudes, 100 nT/m, attitude 1°": Case(SPHERE, 100.0, attitude_error_deg=1.0),
    "all attitudes, 100 nT/m, scalar away": Case(SPHERE, 100.0, scalar_is_away=True),
    "all attitudes, 20 nT/m, scalar away, attitude 1°": Case(SPHERE, 20.0, attitude_error_deg=1.0, scalar_is_away=True),
    "all attitudes, 100 nT/m, scalar away, attitude 1°": Case(
        SPHERE, 100.0, attitude_error_deg=1.0, scalar_is_away=True
    ),
    "±30°, uniform": Case(VEHICLE, 0.0, is_fitted=False),
    "±30°, 100 nT/m, not fitted": Case(VEHICLE, 100.0, is_fitted=False),
    "±30°, 100 nT/m": Case(VEHICLE, 100.0),
    "±30°, 100 nT/m, attitude 1°": Case(VEHICLE, 100.0, attitude_error_deg=1.0),
}
"""Cases by their title: what the array does, the gradient of the field, and what is not as assumed."""


def score(case: Case, seed: int) -> dict[str, FloatArray]:
    """Return the errors over bound and over what is told, and those of the gradient, for one seed."""
    scenario = read_scenario("wu_table_1")
    position_m = AWAY_M if case.scalar_is_away else None
    array = replace(scenario.array, scalar_position_m=position_m)
    gradient = from_nanotesla(case.gradient_nT_per_m) * SHAPE / np.linalg.norm(SHAPE)
    noise = from_degrees(case.attitude_error_deg)
    run = simulate(
        replace(
            scenario,
            array=array,
            motion=case.motion,
            attitude=AttitudeChannel(noise),
            site_gradient_T_per_m=gradient,
            seed=seed,
        )
    )
    mounted = Rotation.from_quat(run.recording.attitude) * Rotation.from_rotvec(noise * MOUNT)
    recording = replace(run.recording, attitude=mounted.as_quat())
    if case.is_fitted:
        calibration = calibrate_with_effects(recording, array, ["ambient_gradient"])
    else:
        calibration = maximum_likelihood(recording, array)
    variance = np.diag(bound(run.center_field_T, run.errors, array.with_stated_noise(), has_scalar=True)).reshape(4, 12)
    error = calibration.errors.to_vector() - run.errors.to_vector()
    found, told = np.full((2, 5), np.nan)
    for part in (part for effect in calibration.effects for part in effect.contributions if part.term == "degree 2"):
        found, told = (np.array([each[name] for name in COMPONENTS]) for each in (part.values, part.standard_errors))
    return {
        "error": error[1:],
        "bound": np.sqrt(variance)[1:],
        "told": calibration.standard_errors[1:],
        "gradient": (found - gradient[TENSOR_ROWS, TENSOR_COLUMNS])[None],
        "gradient told": told[None],
    }


def summarize(name: str, scores: list[dict[str, FloatArray]]) -> list[Row]:
    """Return the rows (case, figure, value, standard error of the value)."""
    error, smallest, told, gradient, gradient_told = (
        np.array([score[key] for score in scores]) for key in ("error", "bound", "told", "gradient", "gradient told")
    )
    rows: list[Row] = []
    for group, columns in GROUPS.items():
        squares = np.mean((error / smallest)[:, :, columns] ** 2, axis=(1, 2))
        rows.append((name, f"{group}, RMSE/bound", *_root(squares)))
    rows.append((name, "within 95 %", *_mean(np.abs(error) < WITHIN_95 * told)))
    rows.append(
        (
            name,
            "gradient within 95 %",
            *_mean(np.where(np.isnan(gradient), np.nan, np.abs(gradient) < WITHIN_95 * gradient_told)),
        )
    )
    rows.append((name, "gradient RMSE [nT/m]", *_root(np.mean(to_nanotesla(gradient) ** 2, axis=(1, 2)))))
    return rows


def _mean(values: np.ndarray) -> tuple[float, float]:
    """Return the mean, and its standard error from the scatter between the runs."""
    means = values.mean(axis=(1, 2))
    return float(means.mean()), float(means.std(ddof=1) / np.sqrt(len(means)))


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
        for name, case in CASES.items():
            results = pool.map(partial(score, case), range(first_seed, first_seed + runs), chunksize=10)
            rows += summarize(name, list(track(results, total=runs, description=name)))
    show(rows, runs)
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/ambient_gradient.py --runs {runs} --first-seed {first_seed}"
        lines = (f'"{case}","{figure}",{value:.6g},{spread:.2g}' for case, figure, value, spread in rows)
        path.write_text("\n".join([f"# {command}", "case,figure,value,standard_error", *lines]) + "\n")


def show(rows: list[Row], runs: int) -> None:
    """Print the rows as one table."""
    figures = list(dict.fromkeys(row[1] for row in rows))
    table = Table("case", *figures, title=f"A site with a gradient, {runs} runs")
    for name in dict.fromkeys(row[0] for row in rows):
        values = [row[2] for row in rows if row[0] == name]
        table.add_row(name, *("" if np.isnan(value) else f"{value:.3f}" for value in values))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
