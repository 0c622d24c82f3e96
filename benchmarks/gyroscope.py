"""Calibration with a gyroscope: errors over the Cramér-Rao bound, coverage, time and memory, and a real recording.

Run ``python benchmarks/gyroscope.py table|cases|changes|gravity|speed|mission|ahrs [--runs 40] [--seed 1]``, or ``…
real PATH.mat …``.

``table``: the bound of the biases of one sensor of 1 nT with a scalar of 0.1 nT, 6000 samples at 10 Hz, one full circle
with swings of pitch and roll of ±5°, by the noise of the gyroscope. ``cases``: over random errors of the sensors, bias
of the gyroscope and noise, the root mean square error of the biases over their bound, that of all errors whitened by
the bound's covariance (many independent numbers, so that fewer runs tell it), and how many of all errors are within
their 95 % intervals; of 100 000 samples a fifth of the runs. ``changes``: in what part of recordings a diagnosis says
that the field at all sensors changed. ``gravity``: what directions of gravity would add to the bound. ``speed``: time
and memory of one calibration. ``mission``: the centre field over its floor in a mission at ±30°, after errors changed
since a calibration ashore and a turn at ±5° (``mission.py``), with a gyroscope of 4 mdps/√Hz and without. ``ahrs``: an
attitude whose heading is that of the raw readings, next to the gyroscope and without it. ``real``: trials of BROAD
(Laidig et al., Data 6(7):72, 2021), one sensor: calibrated by its gyroscope alone, and by the optical attitude.
"""

import re
import resource
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time

import click
import mission
import numpy as np
from gyroscope_cases import BIAS, SPREAD, Case, Gravity, bound
from numpy.linalg import norm, solve
from rich.progress import track
from scipy.io import loadmat
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.fit.joint_calibration import calibrate_jointly
from tam_calibration.gap.field_direction import field_direction
from tam_calibration.gap.model import Model
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import Gyroscope
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla, to_nanotesla
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Manoeuvre

WITHIN = 1.959964
"""Standard errors that hold 95 %."""


def biases_nT(values: FloatArray) -> float:
    """Return the norm of the biases of a vector (12 K,), nT."""
    return to_nanotesla(float(norm(values.reshape(-1, 12)[:, 6:9])))


def bias_bound_nT(covariance: FloatArray) -> float:
    """Return the norm of the bounds of the biases, nT."""
    return biases_nT(np.sqrt(np.diag(covariance)))


TABLE = (None, 0.1, 0.05, 0.01, 0.002)
"""Noise of a sample, degrees per second: none at all, a cheap chip, to fibre optics."""

CASES = (
    *(Case(rate) for rate in TABLE),
    *(Case(rate, sensors=4) for rate in TABLE[1:]),
    *(Case(tilt_deg=tilt) for tilt in (3.0, 10.0, 30.0)),
    *(Case(0.002, tilt_deg=tilt) for tilt in (3.0, 30.0)),
    *(Case(samples=samples) for samples in (600, 2000, 20_000, 100_000)),
    Case(has_scalar=False),
    Case(0.002, sensors=4, has_scalar=False),
)
"""Noise of the gyroscope, sensors, tilt, samples and scalar, each varied about the table."""


def judged(case: Case, runs: int, seed: int) -> list[Row]:
    """Return the errors of a case over its bound, with coverage."""
    errors_nT, bounds_nT, squares, count, within = [], [], [], 0, []
    for number in track(range(runs), case.name):
        recording, errors = case.made(seed + number)
        covariance = bound(case, errors)
        array = case.array
        found: Calibration = calibrate(recording, array) if case.rate_deg_s is None else jointly(recording, array)
        away, told = found.errors.to_vector().ravel() - errors.to_vector().ravel(), found.standard_errors.ravel()
        errors_nT.append(biases_nT(away))
        bounds_nT.append(bias_bound_nT(covariance))
        free = np.diag(covariance) > 0
        if not case.has_scalar:  # the scale is free: only biases can be compared
            free &= np.arange(len(free)) % 12 // 3 == 2
        count = int(free.sum())
        squares.append(float(away[free] @ solve(covariance[np.ix_(free, free)], away[free])))
        within.append(np.mean(np.abs(away[free]) < WITHIN * told[free]))
    spread = np.sqrt(np.mean(np.square(errors_nT)) / np.mean(np.square(bounds_nT)))
    return [
        Row(case.name, "bound of the biases, nT", bounds_nT),
        Row(case.name, "RMSE of the biases over the bound", [float(spread)], most=1.03),
        Row(
            case.name,
            "RMSE of all errors, whitened by the bound",
            [float(np.sqrt(np.mean(squares) / count))],
            most=1.03,
        ),
        Row(case.name, "chance of that ratio, one standard deviation", [1 / np.sqrt(2 * count * runs)]),
        Row(case.name, "coverage of 95 %", [float(np.mean(within))], least=0.93, most=0.97),
    ]


def jointly(recording: Recording, array: Array) -> Calibration:
    """Return the answer of ``calibrate`` without its held-out parts."""
    return calibrate_jointly(recording, array, None, None).calibration


def table_rows(runs: int, seed: int) -> list[Row]:
    """Return the bound for each noise of the gyroscope."""
    rows = []
    for rate in TABLE:
        case = Case(rate)
        bounds = [bias_bound_nT(bound(case, case.made(seed + number)[1])) for number in range(min(runs, 5))]
        rows.append(Row(case.name, "bound of the biases, nT", bounds))
    return rows


def gravity_rows(runs: int, seed: int) -> list[Row]:
    """Return the bound without an accelerometer, and with one that is hardly accelerated (0.5° and 0.3°)."""
    rows, gravity = [], Gravity(*from_degrees(np.array([0.5, 0.3])))
    for turn_deg, samples in ((360.0, 6000), (90.0, 600)):
        for rate in TABLE[1:]:
            case = Case(rate, samples=samples, turn_deg=turn_deg)
            made = [case.made(seed + number)[1] for number in range(min(runs, 5))]
            for name, what in (("without", None), ("with", gravity)):
                bounds = [bias_bound_nT(bound(case, errors, what)) for errors in made]
                rows.append(Row(case.name, f"bound of the biases {name} gravity, nT", bounds))
    return rows


CHANGES = {
    "clean": (0.0, "step"),
    "step of 10 nT": (10e-9, "step"),
    "step of 100 nT": (100e-9, "step"),
    "source passed in 20 s, 100 nT": (100e-9, "passing"),
}
"""Fields at all sensors and the scalar, tesla."""


def change_rows(runs: int, seed: int) -> list[Row]:
    """Return in what part of recordings a diagnosis says that the field changed, and says so near the right time."""
    rows = []
    for case in (Case(), Case(0.1, sensors=4), Case(0.002, sensors=4), Case(has_scalar=False, tilt_deg=30.0)):
        for name, (size_T, kind) in CHANGES.items():
            said, right = [], []
            for number in track(range(runs), f"{case.name}, {name}"):
                rng = np.random.default_rng([seed + number, 5])
                direction, at_s = rng.normal(size=3), rng.uniform(0.2, 0.8) * case.time_s[-1]
                since_s = case.time_s - at_s
                course = since_s > 0 if kind == "step" else np.exp(-((since_s / 10) ** 2))
                recording, _ = case.made(seed + number, np.outer(course, size_T * direction / norm(direction)))
                model = Model.nominal(recording, case.array)
                words = [one for one in field_direction(model, recording, case.array) if "no such turn" in one]
                said.append(bool(words))
                times_s = [float(one) for one in re.findall(r"(?:at|from|to) (\d+\.\d) s?", " ".join(words))]
                right.append(any(abs(time_s - at_s) < (1.0 if kind == "step" else 20.0) for time_s in times_s))
            rows.append(Row(f"{case.name}, {name}", "part in which a change is said", [float(np.mean(said))]))
            if size_T:
                rows.append(Row(f"{case.name}, {name}", "part with the right time", [float(np.mean(right))]))
    return rows


def speed_rows(runs: int, seed: int) -> list[Row]:
    """Return time and memory of whole calibrations."""
    rows = []
    for case in (Case(sensors=4, samples=100_000), Case(sensors=30)):
        recording, _ = case.made(seed)
        times = []
        for _ in range(min(runs, 3)):
            begin = process_time()
            calibrate(recording, case.array)
            times.append(process_time() - begin)
        rows.append(Row(case.name, "time of the processor, s", times, most=10.0))
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        rows.append(Row(case.name, "peak memory until now, MiB", [peak], most=500.0 if case.sensors == 4 else np.inf))
    return rows


MISSION = Gyroscope(from_degrees(4e-3), BIAS)
"""A MEMS gyroscope."""

CHANGED = {
    "bias of one sensor by 5 nT, 90° in 30 s": ("bias", 5.0, 300),
    "biases of all sensors by 20 nT, 90° in 30 s": ("biases", 20.0, 300),
    "biases of all sensors by 20 nT, 5 circles": ("biases", 20.0, 6000),
    "another single sensor, 90° in 30 s": ("sensor", 30.0, 300),
    "another single sensor, 5 circles": ("sensor", 30.0, 6000),
}
"""What has changed since the pier, by how much, and the samples of the turn."""


def mission_rows(runs: int, seed: int) -> list[Row]:
    """Return the centre field over its floor after each change and turn; the mission's own is asked for."""
    rows = []
    for name, (what, size_nT, samples) in CHANGED.items():
        ratios = {True: list[float](), False: list[float]()}
        for number in track(range(runs), name):
            for has_gyroscope, kept in ratios.items():
                kept.append(_mission(what, size_nT, samples, seed + number, has_gyroscope))
        for has_gyroscope, kept in ratios.items():
            way = "with gyroscope" if has_gyroscope else "without"
            rows.append(Row(name, f"refused, {way}", [float(np.mean(np.isnan(kept)))]))
            most = 1.2 if what == "bias" else np.inf
            rows.append(
                Row(name, f"centre over its floor, {way}", [float(np.sqrt(np.nanmean(np.square(kept))))], most=most)
            )
    return rows


def _mission(what: str, size_nT: float, samples: int, seed: int, has_gyroscope: bool) -> float:
    """Return the residual of the centre field at ±30° over that of the true errors, after the update by a turn."""
    scenario, rng = mission.scenario_of(1 if what == "sensor" else 4), np.random.default_rng([seed, 11])
    pier, vector = mission.pier(scenario), scenario.errors.to_vector()
    if what == "sensor":
        vector += SPREAD * rng.normal(size=12) * (np.arange(12) < 9)
    else:
        direction = rng.normal(size=(4, 3))
        if what == "bias":
            direction[np.arange(4) != rng.integers(4)] = 0
            direction /= norm(direction)
        vector[:, 6:9] += from_nanotesla(size_nT) * direction
    scenario = replace(scenario, errors=SensorErrors.from_vector(vector), rate_hz=10.0)
    narrow, work = (Manoeuvre(limit, limit, 120.0) for limit in from_degrees(np.array([5.0, 30.0])))
    made = simulate(replace(scenario, motion=narrow, sample_count=samples, gyroscope=MISSION, seed=seed)).recording
    turn = replace(made, time_s=mission.PIER_S + mission.DIVE_S + made.time_s)
    if not has_gyroscope:
        turn = replace(turn, angular_velocity_rad_s=None)
    array = replace(scenario.array, gyroscope=MISSION)
    try:
        found = calibrate_jointly(turn, array, pier, None).calibration
    except (InputError, Refused):  # a quarter turn does not determine another sensor
        return np.nan
    seen = simulate(replace(scenario, motion=work, sample_count=2400, seed=seed + 500_000)).recording
    after, floor = (measure_residuals(each, array, seen, pier.intensity_T) for each in (found.errors, scenario.errors))
    return after.center_intensity_T / floor.center_intensity_T


LEANING = from_degrees(0.1)
"""Noise of an attitude as it is stated; its heading is wrong by the errors of the compass."""


def ahrs_rows(runs: int, seed: int) -> list[Row]:
    """Return the errors of the biases with an attitude that depends on sensor 1, with the gyroscope and without."""
    case, away, said = Case(), {True: list[FloatArray](), False: list[FloatArray]()}, {True: 0, False: 0}
    for number in track(range(runs), "AHRS"):
        recording, errors = case.made(seed + number)
        _, pitch, roll = case.attitude(recording.time_s).as_euler("ZYX").T
        level = Rotation.from_euler("YX", np.column_stack([pitch, roll])).apply(recording.readings_T[:, 0])
        heading = np.pi / 2 - np.arctan2(level[:, 1], level[:, 0])
        turned = Rotation.from_euler("ZYX", np.column_stack([heading, pitch, roll]))
        noise = Rotation.from_rotvec(np.random.default_rng([seed + number, 3]).normal(0, LEANING, (case.samples, 3)))
        ahrs = replace(recording, attitude=(turned * noise).as_quat())
        array = replace(case.array, attitude_noise=LEANING)
        for has_rates, kept in away.items():
            try:
                found = jointly(ahrs if has_rates else replace(ahrs, angular_velocity_rad_s=None), array)
            except (InputError, Refused):
                said[has_rates] += 1
                continue
            kept.append((found.errors.bias_T - errors.bias_T) / found.standard_errors[:, 6:9])
            said[has_rates] += any("is left out" in note for note in found.notes)
    rows = []
    for has_rates, name in ((True, "AHRS and gyroscope"), (False, "AHRS alone")):
        size = float(np.sqrt(np.mean(np.square(away[has_rates])))) if away[has_rates] else np.nan
        asked = {"most": 1.1} if has_rates else {}
        rows.append(Row(name, "errors of the biases over their standard errors", [size], **asked))
        least = {"least": 1.0} if has_rates else {}
        rows.append(Row(name, "attitude left out or refused, and said so", [said[has_rates] / runs], **least))
    return rows


def real_rows(paths: Sequence[Path]) -> list[Row]:
    """Return how calibrations by gyroscope and by optical attitude differ in trials of BROAD."""
    rows = []
    array = Array(np.zeros((1, 3)))
    for path in paths:
        recording = broad(path)
        by_rates = calibrate(replace(recording, attitude=None), array)
        optical = replace(recording, angular_velocity_rad_s=None)
        by_attitude = calibrate(optical, replace(array, attitude_noise=np.inf))
        alone = calibrate(replace(optical, attitude=None), array)
        name = path.stem
        for what, found in (("gyroscope", by_rates), ("intensity alone", alone)):
            away = found.errors.bias_T - by_attitude.errors.bias_T
            told = np.hypot(found.standard_errors[:, 6:9], by_attitude.standard_errors[:, 6:9])
            rows.append(Row(name, f"bias by {what} less that by attitude, nT", to_nanotesla(np.abs(away[0]))))
            rows.append(Row(name, f"bias by {what} less that by attitude, standard errors", np.abs(away / told)[0]))
            shapes = [each.errors.to_vector()[:, :6] for each in (found, by_attitude)]
            both = np.hypot(found.standard_errors[:, :6], by_attitude.standard_errors[:, :6])
            rows.append(
                Row(name, f"scale and angles by {what}, standard errors", np.abs(np.subtract(*shapes) / both)[0])
            )
        rows.append(
            Row(name, "standard errors of the bias by gyroscope, nT", to_nanotesla(by_rates.standard_errors[0, 6:9]))
        )
        for note in (*by_rates.warnings, *by_rates.notes):
            click.echo(f"{name}: {note}")
    return rows


def broad(path: Path) -> Recording:
    """Return a trial of BROAD where the attitude is known, at the updates of its magnetometer."""
    content = loadmat(path)
    rate_hz = float(content["sampling_rate"].squeeze())
    attitude = content["opt_quat"][:, [1, 2, 3, 0]]
    chosen = np.flatnonzero(np.isfinite(attitude).all(axis=1) & np.isfinite(content["imu_mag"]).all(axis=1))
    chosen = chosen[chosen % 2 == 0]
    time_s = chosen / rate_hz
    return Recording(
        time_s,
        1e-6 * content["imu_mag"][chosen][:, None],
        attitude=attitude[chosen],
        angular_velocity_rad_s=content["imu_gyr"][chosen],
    )


@click.command(help=__doc__)
@click.argument("part", type=click.Choice(["table", "cases", "changes", "gravity", "speed", "mission", "ahrs", "real"]))
@click.argument("paths", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--runs", default=40, show_default=True, help="Recordings of each case.")
@click.option("--seed", default=1, show_default=True, help="Of the first of them.")
@click.option("--only", default="", help="Only cases whose names hold this.")
def main(part: str, paths: tuple[Path, ...], runs: int, seed: int, only: str) -> None:
    """Measure one part, print it, and keep it."""
    if part == "cases":
        rows = [
            row
            for case in CASES
            if only in case.name
            for row in judged(case, runs if case.samples < 100_000 else -(-runs // 5), seed)
        ]
    else:
        made = {
            "table": table_rows,
            "changes": change_rows,
            "gravity": gravity_rows,
            "speed": speed_rows,
            "mission": mission_rows,
            "ahrs": ahrs_rows,
        }
        rows = real_rows(paths) if part == "real" else made[part](runs, seed)
    show("Calibration with a gyroscope", f"gyroscope.py {part} --runs {runs}", f"gyroscope_{part}.csv", rows)


if __name__ == "__main__":
    main()
