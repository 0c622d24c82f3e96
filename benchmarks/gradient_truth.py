"""Centre vector, gradient tensor and invariants of calibrated arrays near a dipole and a coil, against the truth.

Run ``python benchmarks/gradient_truth.py [--runs 30]``. The calibrations see a uniform field only: Wu's Table 1. The
sources are magpylib's, at six places 2.6 to 3.6 m away, beside the Earth's field. Errors are relative to the source's
own field b, the size |G| of its tensor, |G|² for the sum of principal minors I1 and |G|³ for the determinant I2; the
worst component is also told by itself, relative to its own size. Three tables:

1. calibrated without noise: the largest error against an error-free array at the same places, and above it what that
   array itself errs against the truth at the centre, as its baselines are finite;
2. calibrated with Wu's noise: the root mean square error over the runs and places;
3. an array whose sensors are turned together by 0.5° against the baselines: in the uniform field it looks perfect, and
   only the attitude, where it is recorded, shows the turn.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import cache
from pathlib import Path

import click
import magpylib
import numpy as np
from numpy.linalg import norm
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from tam_calibration.core.field_alignment import find_turn
from tam_calibration.correction.calibration import Calibration
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import METHODS
from tam_calibration.model.array import OUTPUT_NAMES, Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, to_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import AttitudeChannel

RESULTS = Path(__file__).parent / "results" / "gradient_truth.csv"
FIGURES = ("b", *OUTPUT_NAMES[3:], "I1", "I2", "worst by itself")

PLACES_M = np.array(
    [[2.4, -1.0, 0.46], [-1.7, 2.1, -0.8], [0.9, 1.3, 2.2], [-2.9, -1.4, 1.6], [1.1, -2.3, -1.9], [0.7, 0.8, -2.6]]
)
"""Of the source, from the centre of the array: 2.6 to 3.6 m away, on all sides."""
TURN = from_degrees(0.5)
"""By which all sensors are turned together, which their readings alone do not show."""

AXES = {"x": (1, 0, 0), "y": (0, 1, 0), "z": (0, 0, 1)}
TURNED_BY_ATTITUDE = "maximum_likelihood + attitude"

Fit = Callable[[Recording, Array], Calibration]


def dipole(place_m: FloatArray) -> magpylib.misc.Dipole:
    """Return a dipole as strong as the coil, aslant."""
    return magpylib.misc.Dipole(position=place_m, moment=(180, -350, 290))


def coil(place_m: FloatArray) -> magpylib.current.Circle:
    """Return the circular coil of Wu 2025 section 4.2, tilted."""
    tilt = Rotation.from_rotvec([0.5, -0.8, 0.3])
    return magpylib.current.Circle(position=place_m, orientation=tilt, diameter=0.89, current=708)


SOURCES = {"dipole": dipole, "coil": coil}


def invariants(outputs: FloatArray) -> FloatArray:
    """Return the (N, 2) sums of principal minors and determinants of the tensors of outputs (N, 9)."""
    tensors = np.array([tensor_of(row) for row in outputs])
    minors = (np.trace(tensors, axis1=1, axis2=2) ** 2 - np.trace(tensors @ tensors, axis1=1, axis2=2)) / 2
    return np.stack([minors, np.linalg.det(tensors)], axis=1)


def tensor_of(output: FloatArray) -> FloatArray:
    """Return the (3, 3) tensor of an output (9,)."""
    xx, xy, xz, yy, yz, zz = output[3:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def fields_at_sensors(source: str, array: Array) -> FloatArray:
    """Return the (6, K, 3) fields of a source at its places, tesla."""
    return np.array([SOURCES[source](place).getB(array.positions_m) for place in PLACES_M])


@cache
def truth(source: str) -> FloatArray:
    """Return the (6, 9) outputs that an array of no extent would give: the source's field and its slope.

    The slope is a central difference of sixth order, right to ten digits at these distances.
    """
    step_m = 0.02
    weights = np.array([45, -9, 1]) / (60 * step_m)
    outputs = []
    for place in PLACES_M:
        made = SOURCES[source](place)
        slopes = [
            sum(
                weight * (made.getB(count * step_m * axis) - made.getB(-count * step_m * axis))
                for count, weight in enumerate(weights, start=1)
            )
            for axis in np.eye(3)
        ]
        tensor = np.array(slopes)
        outputs.append(np.concatenate([made.getB((0, 0, 0)), tensor[np.triu_indices(3)]]))
    return np.array(outputs)


def relative_errors(outputs: FloatArray, expected: FloatArray) -> FloatArray:
    """Return the (N, 10) errors of outputs (N, 9) in the order of ``FIGURES``."""
    error = np.abs(outputs - expected)
    size = norm([tensor_of(row) for row in expected], axis=(1, 2))
    vector = norm(error[:, :3], axis=1) / norm(expected[:, :3], axis=1)
    invariant = np.abs(invariants(outputs) - invariants(expected)) / np.stack([size**2, size**3], axis=1)
    by_itself = (error[:, 3:] / np.abs(expected[:, 3:])).max(axis=1)
    return np.column_stack([vector, error[:, 3:] / size[:, None], invariant, by_itself])


def judge(calibration: Calibration | None, true: SensorErrors, site_field_T: FloatArray, source: str) -> FloatArray:
    """Return the (6, 10) relative errors of a calibrated array against an error-free one at the same places.

    NaN where there is no calibration.
    """
    if calibration is None:
        return np.full((len(PLACES_M), len(FIGURES)), np.nan)
    array = calibration.array
    outputs = calibration.apply(true.distort(fields_at_sensors(source, array) + site_field_T))
    outputs[:, :3] -= site_field_T
    return relative_errors(outputs, ideal(source, array))


def ideal(source: str, array: Array) -> FloatArray:
    """Return the (6, 9) outputs of an error-free array."""
    return fields_at_sensors(source, array).reshape(len(PLACES_M), -1) @ array.operator.T


def methods() -> dict[str, Fit]:
    """Return every method, and the default one with its frame taken from the recorded attitude."""
    return METHODS | {TURNED_BY_ATTITUDE: _turned_by_attitude}


def _turned_by_attitude(recording: Recording, array: Array) -> Calibration:
    calibration = METHODS["maximum_likelihood"](recording, array)
    field = calibration.errors.restore(recording.readings_T).mean(axis=1)
    to_world = Rotation.from_quat(recording.attitude).as_matrix()
    turn = find_turn(field / np.sqrt(np.mean(norm(field, axis=1) ** 2)), to_world)
    errors = SensorErrors.from_matrix(calibration.errors.matrix @ turn.T, calibration.errors.bias_T)
    return replace(calibration, errors=errors)


def turned_together(errors: SensorErrors, axis: tuple[float, float, float]) -> SensorErrors:
    """Return the errors of sensors that are turned together, by 0.5° about an axis of the array."""
    turn = Rotation.from_rotvec(TURN * np.array(axis)).as_matrix()
    return SensorErrors.from_matrix(errors.matrix @ turn, errors.bias_T)


Row = tuple[str, str, str, str, float]


def calibrated_without_noise() -> Iterable[Row]:
    """Yield the rows of the first table."""
    scenario = _scenario()
    run = simulate(_silent(scenario))
    for source in SOURCES:
        baseline = relative_errors(ideal(source, scenario.array), truth(source))
        yield from _rows("against the truth", "error-free array", source, baseline.max(axis=0))
    for name, fit in methods().items():
        calibration = _fit(fit, run.recording, scenario.array)
        for source in SOURCES:
            errors = judge(calibration, run.errors, scenario.site_field_T, source)
            yield from _rows("calibrated without noise", name, source, errors.max(axis=0))


def calibrated_with_noise(runs: int, first_seed: int) -> Iterable[Row]:
    """Yield the rows of the second table."""
    scenario = _scenario()
    squares: dict[tuple[str, str], list[FloatArray]] = {}
    for seed in track(range(first_seed, first_seed + runs), description=f"{runs} runs"):
        run = simulate(replace(scenario, seed=seed))
        for name, fit in methods().items():
            calibration = _fit(fit, run.recording, scenario.array)
            for source in SOURCES:
                errors = judge(calibration, run.errors, scenario.site_field_T, source)
                squares.setdefault((name, source), []).append(np.mean(errors**2, axis=0))
    for (name, source), values in squares.items():
        yield from _rows("calibrated with noise", name, source, np.sqrt(np.mean(values, axis=0)))


def turned_against_baselines() -> Iterable[Row]:
    """Yield the rows of the third table."""
    scenario = _silent(_scenario())
    for axis, direction in AXES.items():
        run = simulate(replace(scenario, errors=turned_together(scenario.errors, direction)))
        for name, fit in methods().items():
            calibration = _fit(fit, run.recording, _scenario().array)
            for source in SOURCES:
                errors = judge(calibration, run.errors, scenario.site_field_T, source)
                yield from _rows(f"turned by 0.5° about {axis}", name, source, errors.max(axis=0))
                uniform = to_nanotesla(calibration.in_sample.tensor_rmse_T_per_m) if calibration else np.nan
                yield f"turned by 0.5° about {axis}", name, source, "uniform e_T [nT/m]", uniform


def _scenario() -> Scenario:
    return replace(read_scenario("wu_table_1"), attitude=AttitudeChannel())


def _silent(scenario: Scenario) -> Scenario:
    return replace(scenario, array=replace(scenario.array, vector_noise_T=None, scalar_noise_T=None))


def _fit(fit: Fit, recording: Recording, array: Array) -> Calibration | None:
    """Return the calibration, or None where the method refuses this recording."""
    try:
        return fit(recording, array)
    except (InputError, Refused):
        return None


def _rows(data: str, method: str, source: str, values: FloatArray) -> Iterable[Row]:
    for figure, value in zip(FIGURES, values, strict=True):
        yield data, method, source, figure, float(value)


@click.command(help=__doc__)
@click.option("--runs", default=30, show_default=True, help="Noisy calibrations of each method.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
def main(runs: int, first_seed: int) -> None:
    """Run the benchmark."""
    rows = [*calibrated_without_noise(), *calibrated_with_noise(runs, first_seed), *turned_against_baselines()]
    for data in dict.fromkeys(row[0] for row in rows):
        show(data, [row for row in rows if row[0] == data])
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/gradient_truth.py --runs {runs} --first-seed {first_seed}"
        header = "data,method,source,figure,value"
        lines = [
            f"# {command}",
            header,
            *(",".join(f'"{part}"' for part in row[:4]) + f",{row[4]:.6g}" for row in rows),
        ]
        path.write_text("\n".join(lines) + "\n")


def show(data: str, rows: list[Row]) -> None:
    """Print the rows of one kind of data as a table, the worse of dipole and coil."""
    figures = list(dict.fromkeys(row[3] for row in rows))
    table = Table("method", *figures, title=f"{data}: relative errors, the larger of dipole and coil")
    for method in dict.fromkeys(row[1] for row in rows):
        worst = [max(row[4] for row in rows if row[1] == method and row[3] == figure) for figure in figures]
        table.add_row(method, *("refused" if np.isnan(value) else f"{value:.1e}" for value in worst))
    Console(width=160).print(table)


if __name__ == "__main__":
    main()
