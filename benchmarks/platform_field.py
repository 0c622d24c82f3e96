"""The vehicle's own field: an AUV with 20 m² of iron in its hull, and the scalar of public flight data.

Run ``python benchmarks/platform_field.py [FOLDER]``. The hull is that of the check on withheld effects: a row of
ellipsoids with demagnetisation factors that keep a moment and are magnetised, and shells whose currents are integrated
in time; intensities are lengths of vector sums. A run is calibrated without and with ``platform_field``; residuals of
the scalar are those of that run and of another one of the same vehicle, over the floor of the noise; infinite where
the calibration is refused.

FOLDER is ``test/test_data`` of github.com/MIT-AI-Accelerator/MagNav.jl: of the line in ``test_data_TL.mat`` it tells
what the 18 terms of the effect and a trend leave of the scalar, and whether fits of the fluxgate take such lines, alone
and beside `TOLERANCES`. It also tells what calibrations by one half of that line leave in either, and how much of that
their covariance tells.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.surroundings import PlatformField
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import calibrate
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.gap.calibration_with_effects import calibrate_with_effects
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Tolerances
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import SCALAR
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, residual_series
from tam_calibration.model.units import FloatArray, from_nanotesla, to_nanotesla
from tam_calibration.simulation.conditions import Manoeuvre, Motion, Tumble
from tam_validation.blind.vehicle import Body, driven

RESULTS = Path(__file__).parent / "results" / "platform_field.csv"
IRON_M2, BODIES, LENGTH_M, PLATE_M, SUSCEPTIBILITY = 20.0, 12, 10.0, 0.004, 150.0
"""Surface, number of ellipsoids, and length of the hull; thickness and susceptibility of its plates."""

BOOM_M, SCALAR_M = 1.5, 0.6
"""From the bow to the array's centre, and from there back to the scalar magnetometer."""

ARRAY = Array.cross(0.5, 1e-9, 1e-10)
"""The cross of Wu 2025, with the noise of a good fluxgate and of a scalar magnetometer."""

RATE_HZ, SECONDS, FINE = 20.0, 200.0, 10
"""Rate and length of a run, of 4000 samples; and the steps from one to the next in which currents are integrated."""

WORLD_T = np.array([3e-6, 18e-6, -46e-6])
"""A field of middle latitudes, east, north, up."""

TOLERANCES = Tolerances(0.05, np.radians(3), 3e-6, np.radians(3))
"""What is known of a fluxgate in a cabin before any calibration."""

MOTIONS: dict[str, Motion] = {
    "turned over ashore": Tumble(np.radians(20)),
    "at sea, pitch and roll of 30°": Manoeuvre(np.radians(30), np.radians(30), 40.0),
}


def hull() -> list[Body]:
    """Return ellipsoids behind each other, all together of the hull's surface."""
    half = LENGTH_M / BODIES / 2
    radius = IRON_M2 / (2 * np.pi * LENGTH_M)
    starts = -BOOM_M - half * (1 + 2 * np.arange(BODIES))
    return [Body(np.array([start, 0.0, 0.0]), np.array([1.0, 0.0, 0.0]), half, radius) for start in starts]


def vehicle_field(field_T: FloatArray, step_s: float, rng: np.random.Generator) -> FloatArray:
    """Return the vehicle's field (N, K + 1, 3) at the sensors and the scalar in a field (N, 3) of so fine steps."""
    places = np.vstack([ARRAY.positions_m, [-SCALAR_M, 0, 0]])
    total = np.zeros((len(field_T), len(places), 3))
    for body in hull():
        # A thin shell is magnetised like a solid of the susceptibility times the part of the volume that is iron.
        induced = body.magnetised(SUSCEPTIBILITY * 2 * PLATE_M / body.radius_m, 1.0)
        kept = norm(induced) * norm(WORLD_T) * rng.normal(size=3)
        answer = -1.5 * body.volume_m3 / (4e-7 * np.pi) * body.tensor(*rng.uniform(0.5, 1.0, 2))
        currents = driven(np.diff(field_T, axis=0) @ answer.T, step_s, rng.uniform(0.02, 0.03))
        total += np.einsum("pij,nj->npi", body.dipole(places), field_T @ induced.T + kept + currents)
    return total


def run(motion: Motion, vehicle: int, noise: int) -> Recording:
    """Return what a vehicle reads on a run: sensors without errors of their own, and the scalar."""
    count = int(SECONDS * RATE_HZ)
    fine_s = np.arange(-FINE * RATE_HZ, FINE * count) / (FINE * RATE_HZ)  # settled before the run begins
    rng = np.random.default_rng(noise)
    attitude = motion.attitudes(fine_s - fine_s[0] + rng.uniform(0, 30), rng)
    field = Rotation.from_quat(attitude).inv().apply(WORLD_T)
    own = vehicle_field(field, 1 / (FINE * RATE_HZ), np.random.default_rng(vehicle))
    at = slice(int(FINE * RATE_HZ), None, FINE)
    total = (field[:, None] + own)[at]
    assert ARRAY.vector_noise_T is not None and ARRAY.scalar_noise_T is not None
    readings = total[:, :-1] + rng.normal(0, ARRAY.vector_noise_T[0], total[:, :-1].shape)
    scalar = norm(total[:, -1], axis=1) + rng.normal(0, ARRAY.scalar_noise_T, len(total))
    return Recording(fine_s[at], readings, scalar)


def over_floor(calibration: Calibration, recording: Recording) -> float:
    """Return the residual of the scalar against the length of the centre field, over the floor of the noise."""
    clean = calibration.without_effects(recording)
    assert clean.scalar_T is not None
    residual = norm(calibration.apply(clean.readings_T)[:, :3], axis=1) - clean.scalar_T
    return float(np.sqrt(np.mean(residual**2)) / calibration.floor.center_intensity_T)


def of_hull(vehicles: int) -> Iterator[tuple[str, str, float]]:
    """Yield case, figure and value: the worst of some vehicles."""
    for name, motion in MOTIONS.items():
        worst: dict[str, float] = {}
        for vehicle in range(vehicles):
            first, second = (run(motion, vehicle, 1000 * part + vehicle) for part in (1, 2))
            plain = maximum_likelihood(first, ARRAY)  # calibrate leaves such a scalar out
            figures = {"without the effect": over_floor(plain, first)}
            try:
                kept = calibrate_with_effects(first, ARRAY, ["platform_field"])
                of_runs = over_floor(kept, first), over_floor(kept, second)
            except (InputError, Refused) as problem:
                click.echo(f"refused: {problem}")
                of_runs = np.inf, np.inf
            figures |= dict(zip(("with it", "with it, on another run"), of_runs, strict=True))
            worst = {figure: max(value, worst.get(figure, 0.0)) for figure, value in figures.items()}
        yield from ((name, f"scalar residual over floor, {figure}", value) for figure, value in worst.items())


def matlab(path: Path, name: str) -> dict[str, FloatArray]:
    """Return the fields of a structure in a file of MATLAB."""
    from scipy.io import loadmat

    structure: Any = loadmat(path)[name][0, 0]
    return {each: np.squeeze(structure[each]) for each in structure.dtype.names}


def of_flights(folder: Path) -> Iterator[tuple[str, str, float]]:
    """Yield what is left of the scalar on a flight's line, and whether it is calibrated."""
    line = matlab(folder / "test_data_TL.mat", "TL_data")
    fluxgate = from_nanotesla(np.column_stack([line[f"flux_a_{axis}"] for axis in "xyz"]))
    scalar = from_nanotesla(line["mag_1_uc"])
    time_s = np.arange(len(scalar)) / float(line["fs"])
    array = Array(np.zeros((1, 3)))
    # Of the fluxgate the direction alone: it has errors of hundreds of nanoteslas, and the Earth's intensity is even.
    field = fluxgate / norm(fluxgate, axis=1)[:, None] * np.mean(scalar)
    covariates = Covariates(time_s, field, SensorErrors.none(1), array)
    shape = {"time_constant_s": 0.3 * covariates.step_s}
    terms = {term.name: term.features for term in PlatformField().terms(covariates, shape) if term.sensor == SCALAR}
    eighteen = np.hstack([terms[name] for name in ("permanent", "induced", "first mode")])
    assert eighteen.shape[1] == 18
    for degree, trend in ((0, "mean"), (1, "linear trend"), (2, "quadratic trend")):
        course = np.polynomial.legendre.legvander(np.linspace(-1, 1, len(scalar)), degree) * np.mean(scalar)
        design = np.hstack([eighteen, course])
        design /= norm(design, axis=0)
        left = scalar - design @ np.linalg.lstsq(design, scalar, rcond=1e-12)[0]
        yield "flight, test_data_TL", f"scalar after 18 terms and {trend}, nT", float(to_nanotesla(left.std()))
    recording = Recording(time_s, fluxgate[:, None], scalar)
    yield "flight, test_data_TL", "calibrated with platform_field", _is_calibrated(recording, array)
    beside = replace(array, tolerances=TOLERANCES)
    yield "flight, test_data_TL", "calibrated beside tolerances", _is_calibrated(recording, beside, ())
    whole = calibrate(recording, beside)
    assert whole.held_out is not None
    for name, residuals in {"before": whole.before, "held out": whole.held_out}.items():
        left_nT = float(to_nanotesla(residuals.center_intensity_T))
        yield "flight, test_data_TL", f"|B| against the scalar, {name}, nT", left_nT
    yield from of_halves(recording, beside)
    other = matlab(folder / "test_data_traj.mat", "traj")
    to_world = Rotation.from_matrix(np.moveaxis(other["Cnb"], -1, 0)).inv().as_quat()
    readings = from_nanotesla(np.column_stack([other[f"flux_a_{axis}"] for axis in "xyz"]))[:, None]
    recording = Recording(np.asarray(other["tt"], dtype=float), readings, attitude=to_world)
    yield "flight, test_data_traj, with attitude", "calibrated", _is_calibrated(recording, array, ())


def of_halves(recording: Recording, array: Array) -> Iterator[tuple[str, str, float]]:
    """Yield what calibrations of one half of a line, beside the array's tolerances, leave of |B| in each half."""
    middle = recording.sample_count // 2
    halves = {"first": recording.take(slice(middle)), "second": recording.take(slice(middle, None))}
    for fitted, half in halves.items():
        calibration = calibrate(half, array)
        for judged, other in halves.items():
            name = f"calibrated beside tolerances by the {fitted} half, in the {judged}"
            residual = residual_series(calibration.errors, array, other, np.nan)
            left = residual.center_intensity_T
            yield "flight, test_data_TL", f"{name} it leaves, nT", float(to_nanotesla(np.sqrt(np.mean(left**2))))
            yield "flight, test_data_TL", f"{name} it tells, nT", float(to_nanotesla(told_T(calibration, other)))


def told_T(calibration: Calibration, recording: Recording) -> float:
    """Return the standard error of |B| that the covariance of a calibration of one sensor tells, over a recording."""
    assert calibration.covariance is not None
    field = calibration.apply(recording.readings_T)[:, :3]
    direction = field / norm(field, axis=1)[:, None]
    by_readings = direction @ np.linalg.inv(calibration.errors.matrix[0])
    rows = np.einsum("icp,nc->nip", calibration.errors.jacobian()[0], np.column_stack([field, np.ones(len(field))]))
    slope = np.einsum("ni,nip->np", by_readings, rows)
    return float(np.sqrt(np.mean(np.einsum("np,pq,nq->n", slope, calibration.covariance, slope))))


def _is_calibrated(recording: Recording, array: Array, effects: tuple[str, ...] = ("platform_field",)) -> float:
    """Return 1 where a fit takes a recording, else 0, and tell why it does not."""
    try:
        calibrate_with_effects(recording, array, effects)
    except (InputError, Refused) as problem:
        click.echo(f"refused: {problem}")
        return 0.0
    return 1.0


@click.command(help=__doc__)
@click.argument("folder", type=click.Path(path_type=Path), required=False)
@click.option("--vehicles", default=5, show_default=True)
def main(folder: Path | None, vehicles: int) -> None:
    """Measure, print and write the results."""
    rows = list(of_hull(vehicles))
    if folder is None or not (folder / "test_data_TL.mat").is_file():
        click.echo("the flight data are left out: give the folder test/test_data of MIT-AI-Accelerator/MagNav.jl")
    else:
        rows += of_flights(folder)
    for case, figure, value in rows:
        click.echo(f"{case}: {figure}: {value:.3g}")
    with write_whole(RESULTS) as beside:
        command = f"python benchmarks/platform_field.py {'test/test_data ' if folder else ''}--vehicles {vehicles}"
        lines = [f'"{case}","{figure}",{value:.6g}\n' for case, figure, value in rows]
        beside.write_text("".join([f"# {command}\n", "case,figure,value\n", *lines]), encoding="utf-8")


if __name__ == "__main__":
    main()
