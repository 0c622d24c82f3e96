"""How well sources are located, and what a known source shows of an array: figure by figure beside what is asked.

Run ``python benchmarks/localization.py [--runs 500]``. The set-up is that of Wu 2025 section 4.2: a coil of 708 ampere
turns, 2.64 m away in a random direction of its axis, a cross of 0.21 m, twelve headings, the errors of his Table 2.
Ratios compare root mean square errors of the same runs, or with the Cramér–Rao bound; amplitudes have 0.05 nT of noise.
"""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from asked import ANYTHING, Figure
from numpy.linalg import inv, norm
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.spatial.transform import Rotation

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.files.scenario import read_scenario
from tam_calibration.files.whole import write_whole
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.source_calibration import SourceCalibration, calibrate_by_source
from tam_calibration.localization.background import background_of, turning_of
from tam_calibration.localization.demodulation import demodulate
from tam_calibration.localization.dipole import Dipole, dipole_field
from tam_calibration.localization.direct_fit import fit_loop
from tam_calibration.localization.euler import locate
from tam_calibration.localization.finite_baseline import locate_dipole
from tam_calibration.localization.loop import Loop
from tam_calibration.localization.poses import Poses
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.localization.spectrum import band_pass_amplitude
from tam_calibration.localization.tracking import straight_track, track_dipole
from tam_calibration.reproduce.wu2025_coil import AMPERE_TURNS, HEADINGS_DEG, POSITION_M, RADIUS_M
from tam_calibration.simulation import simulate
from tam_calibration.simulation.attitude import Manoeuvre
from tam_calibration.units import FloatArray, from_degrees, from_nanotesla

RESULTS = Path(__file__).parent / "results" / "localization.csv"
AMPLITUDE_NOISE_T = from_nanotesla(0.05)
SENSOR_NOISE_T = from_nanotesla(1.0)
RANGE_M = float(norm(POSITION_M))
MOMENT_AM2 = AMPERE_TURNS * np.pi * RADIUS_M**2
ARRAY = Array.cross(0.21, vector_noise_T=AMPLITUDE_NOISE_T)
POSES = Poses.headings(Rotation.from_euler("z", from_degrees(HEADINGS_DEG)[:, None]).as_quat())


def directions(generator: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) random directions."""
    drawn = generator.standard_normal((count, 3))
    unit: FloatArray = drawn / norm(drawn, axis=1, keepdims=True)
    return unit


def exact(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of the Euler solution for exact fields and tensors of dipoles at any place."""
    places, moments = (
        10 ** generator.uniform(-1, 2, (runs, 1)) * directions(generator, runs),
        directions(generator, runs),
    )
    field, gradient, _ = dipole_field(-places, moments)
    outputs = np.column_stack([field, gradient[:, (0, 0, 0, 1, 1), (0, 1, 2, 1, 2)]])
    for constrained in (True, False):
        found = locate(outputs, constrained=constrained)
        error = norm(found.position_m - places, axis=1) / norm(places, axis=1)
        name = "Euler, constrained" if constrained else "Euler, unconstrained"
        asked = (0.0, 1e-9) if constrained else ANYTHING
        yield Figure(
            "exact dipole and tensor", name, "largest error of position over range", float(error.max()), asked=asked
        )


def dipole_at_the_coil(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors that finite baselines leave, all around the array."""
    places = RANGE_M * directions(generator, runs)
    moments = MOMENT_AM2 * directions(generator, runs)
    readings = dipole_field(ARRAY.positions_m - places[:, None], moments[:, None])[0].reshape(runs, -1)
    outputs, case = readings @ ARRAY.operator.T, "dipole at 2.64 m, baseline 0.21 m"
    for name, found, asked in (
        ("Euler, constrained", locate(outputs), ANYTHING),
        ("true baselines", locate_dipole(outputs, ARRAY), (0.0, 0.003)),
    ):
        position = norm(found.position_m - places, axis=1).max() / RANGE_M
        yield Figure(case, name, "largest error of r over range", _largest(found.distance_m - RANGE_M), asked=asked)
        yield Figure(case, name, "largest error of position over range", float(position))


def coil(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of Euler and dipole solutions and of the fitted loop for the coil, the fit with noise.

    The error of a direction of the coil is the root mean square over the headings, as the paper tells it.
    """
    found: dict[str, list[FloatArray]] = {"Euler, constrained": [], "true baselines": []}
    fitted, pulls = [], []
    for axis in track(directions(generator, runs), description="coil"):
        source = Loop(POSITION_M, MOMENT_AM2 * axis, RADIUS_M)
        fields = _in_array(source)
        outputs = fields.reshape(len(fields), -1) @ ARRAY.operator.T
        for name, solutions in zip(found, (locate(outputs), locate_dipole(outputs, ARRAY)), strict=True):
            found[name].append(solutions.distance_m - RANGE_M)
        fit = fit_loop(fields + AMPLITUDE_NOISE_T * generator.standard_normal(fields.shape), ARRAY, RADIUS_M, POSES)
        fitted.append(norm(fit.source.position_m - POSITION_M))
        pulls.append((fit.source.position_m - POSITION_M) / fit.position_standard_errors_m)
    case = "coil, 12 headings"
    for name, errors in found.items():
        asked = (0.0, 0.03) if name.startswith("Euler") else ANYTHING
        worst = np.sqrt(np.mean(np.square(errors), axis=1)).max() / RANGE_M
        yield Figure(case, name, "RMSE of r over range, the worst direction of the coil", float(worst), asked=asked)
        yield Figure(case, name, "largest error of r over range in any heading", _largest(errors))
        yield Figure(case, name, "RMSE of r [m]", _rms(errors))
    yield Figure(case, "loop fit", "largest error of position [m]", float(max(fitted)), asked=(0, 1e-3))
    yield Figure(case, "loop fit", "RMSE of position [m]", _rms(fitted))
    yield _ratio(case, "loop fit", "RMSE of position/bound", np.square(pulls), ANYTHING)


def calibrated(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield how much worse sources are located after a calibration of 72 poses with 1 nT than with none needed."""
    scenario = read_scenario("wu_turntable")
    turntable = replace(scenario, array=replace(scenario.array, vector_noise_T=np.full(4, SENSOR_NOISE_T)), drift=None)
    squares: dict[tuple[str, str], list[tuple[FloatArray, FloatArray]]] = {}
    for run in track(range(runs), description="calibrated"):
        calibration = maximum_likelihood(simulate(replace(turntable, seed=run)).recording, turntable.array)
        axis = MOMENT_AM2 * directions(generator, 1)[0]
        through = inv(calibration.errors.matrix) @ scenario.errors.matrix
        for kind, source in (("coil", Loop(POSITION_M, axis, RADIUS_M)), ("dipole", Dipole(POSITION_M, axis))):
            fields = _in_array(source)
            for size, noise in (("1 nT", SENSOR_NOISE_T), ("0.05 nT", AMPLITUDE_NOISE_T)):
                noisy = fields + noise * generator.standard_normal(fields.shape)
                pair = [
                    each.reshape(len(fields), -1) @ ARRAY.operator.T
                    for each in (np.einsum("kij,nkj->nki", through, noisy), noisy)
                ]
                euler = [_square_of_distance(locate(outputs)) for outputs in pair]
                squares.setdefault((f"{kind}, {size}", "Euler, constrained"), []).append((euler[0], euler[1]))
                if kind == "dipole":
                    better = [_square_of_distance(locate_dipole(outputs, ARRAY)) for outputs in pair]
                    squares.setdefault((f"{kind}, {size}", "true baselines"), []).append((better[0], better[1]))
    for (case, method), each in squares.items():
        after, perfect = np.array(each).mean(axis=2).T
        ratio = np.sqrt(after.mean() / perfect.mean())
        spread = ratio / 2 * np.std(after / after.mean() - perfect / perfect.mean(), ddof=1) / np.sqrt(runs)
        name = "RMSE of r after maximum_likelihood over that of an error-free array"
        yield Figure(case, method, name, float(ratio), float(spread), (0.0, 1.05))


def source_calibration(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of baseline scale, common rotation and places of the axes over the Cramér–Rao bound."""
    errors = read_scenario("wu_turntable").errors
    source = Loop(POSITION_M, MOMENT_AM2 * np.array([0.6, -0.6, 0.5291503]), RADIUS_M)
    fits = []
    for _ in track(range(runs), description="source"):
        truth = _faulty_array(generator)
        clean = np.einsum("kij,nkj->nki", errors.matrix, _elements(source, truth, errors))
        exactly = _by_source(clean, source, errors)
        fits.append(
            (exactly, _by_source(clean + AMPLITUDE_NOISE_T * generator.standard_normal(clean.shape), source, errors))
        )
    squares = [(noisy.parameters - true.parameters) ** 2 for true, noisy in fits]
    bounds = [np.diag(true.covariance) for true, _ in fits]
    case = "source calibration, 12 headings"
    for name, part in (
        ("baseline scale", slice(0, 1)),
        ("common rotation", slice(1, 4)),
        ("places of the axes", slice(4, None)),
    ):
        ratio = [square[part].sum() / bound[part].sum() for square, bound in zip(squares, bounds, strict=True)]
        yield _ratio(case, "calibrate_by_source", f"{name}, RMSE/bound", ratio, (0.0, 1.1))
    typical = np.sqrt(np.mean(bounds, axis=0))
    yield Figure(case, "bound", "baseline scale", float(typical[0]))
    yield Figure(case, "bound", "common rotation [rad]", float(typical[1:4].max()))
    yield Figure(case, "bound", "place of an axis, the worst [m]", float(typical[4:].max()))


def demodulation(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of amplitudes at 10 Hz over σ √(2/N), which takes phase and background for known."""
    time = np.arange(2000) / 100
    attitude = Manoeuvre(from_degrees(25), from_degrees(25), 20.0).attitudes(time, generator)
    background, turning = background_of(time, attitude), turning_of(attitude, 3)
    site = Rotation.from_quat(attitude).inv().apply(read_scenario("wu_turntable").site_field_T)
    drift = np.outer(np.sin(2 * np.pi * time / 300), from_nanotesla(np.array([8.0, 5.0, -6.0])))
    carrier = np.sin(2 * np.pi * 10 * (time - time[[0, -1]].mean()) + 0.4)[:, None]
    bound = SENSOR_NOISE_T * np.sqrt(2 / len(time))
    ratios: dict[tuple[str, str], list[float]] = {}
    for _ in track(range(runs), description="demodulation"):
        amplitude = from_nanotesla(np.array(generator.uniform(10, 1000))) * directions(generator, 1)[0]
        for rests, signal in (("array", carrier * amplitude), ("world", carrier * (turning @ amplitude))):
            noisy = site + drift + signal + SENSOR_NOISE_T * generator.standard_normal(signal.shape)
            found = demodulate(time, noisy, 10.0, background, turning if rests == "world" else None).amplitude
            ratios.setdefault((rests, "synchronous least squares"), []).append(_square(found, amplitude, bound))
            if rests == "array":
                passed = band_pass_amplitude(time, noisy, 8, 12)
                ratios.setdefault((rests, "band-pass 8 to 12 Hz"), []).append(_square(passed, amplitude, bound))
    for (rests, method), squares in ratios.items():
        case = f"10 Hz, 20 s, 1 nT, platform turns, source rests in the {rests}"
        asked = (0.0, 1.05) if method.startswith("synchronous") else ANYTHING
        yield _ratio(case, method, "amplitude, RMSE/bound", squares, asked)


def passing(generator: np.random.Generator, runs: int) -> Iterable[Figure]:
    """Yield the errors of a steady dipole that is passed, over the standard errors."""
    array, time = Array.cross(0.5, vector_noise_T=SENSOR_NOISE_T), np.arange(200) / 5
    position = straight_track(time, np.array([-20.0, 0, 0]), np.array([1.0, 0, 0]))
    sway = Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(time, [0.2, 0.33, 0.5])))
    points = position[:, None] + np.einsum("nij,kj->nki", sway.as_matrix(), array.positions_m)
    site, source = (
        read_scenario("wu_turntable").site_field_T,
        Dipole(np.array([2.0, 3.0, -2.5]), np.array([100.0, 200, -300])),
    )
    fields = np.einsum("nji,nkj->nki", sway.as_matrix(), source.field_T(points) + site)
    for noise_deg in (0.0, 0.1):
        noise = from_degrees(noise_deg)
        squares, errors = [], []
        for _ in track(range(runs), description=f"passing, {noise_deg}°"):
            reported = (sway * Rotation.from_rotvec(noise * generator.standard_normal((len(time), 3)))).as_quat()
            noisy = fields + SENSOR_NOISE_T * generator.standard_normal(fields.shape)
            fit = track_dipole(noisy, array, Poses(reported, position, noise)).fit
            error = fit.source.position_m - source.position_m
            squares.append(error @ inv(fit.covariance[:3, :3]) @ error / 3)
            errors.append(norm(error))
        case = f"passing a steady dipole, attitude to {noise_deg}°"
        yield _ratio(case, "track_dipole", "error of position over its standard error", squares, ANYTHING)
        yield Figure(case, "track_dipole", "RMSE of position [m]", _rms(errors))


def _in_array(source: Dipole | Loop) -> FloatArray:
    """Return the (12, 4, 3) fields at the sensors in the array frame."""
    turn = POSES.matrix
    fields: FloatArray = np.einsum(
        "nji,nkj->nki", turn, source.field_T(np.einsum("nij,kj->nki", turn, ARRAY.positions_m))
    )
    return fields


def _faulty_array(generator: np.random.Generator) -> SourceCalibration:
    """Return baselines wrong by 3 %, a frame turned by half a degree, and axes 5 mm from their places, at random."""
    scale, rotation = 1 + 0.03 * generator.standard_normal(), from_degrees(0.5 * generator.standard_normal(3))
    return SourceCalibration(scale, rotation, 5e-3 * generator.standard_normal((4, 3, 3)), np.zeros((40, 40)), 0.0, 0)


def _elements(source: Loop, truth: SourceCalibration, errors: SensorErrors) -> FloatArray:
    """Return (12, 4, 3) numbers that the matrices of the errors turn into what the displaced elements read."""
    turn, array = POSES.matrix, truth.array_of(ARRAY)
    world = source.field_T(np.einsum("nij,kaj->nkai", turn, array.element_positions_m))
    rows = truth.errors_of(errors).matrix
    raw = np.einsum("kai,nji,nkaj->nka", rows, turn, world, optimize=True)
    undone: FloatArray = np.einsum("kij,nkj->nki", inv(errors.matrix), raw)
    return undone


def _by_source(amplitudes_T: FloatArray, source: Loop, errors: SensorErrors) -> SourceCalibration:
    return calibrate_by_source(amplitudes_T, AMPLITUDE_NOISE_T, source, POSES, errors, ARRAY)


def _square_of_distance(found: EulerSolutions) -> FloatArray:
    return (found.distance_m - RANGE_M) ** 2


def _square(found: FloatArray, true: FloatArray, bound: float) -> float:
    """Return the mean squared error over the bound's, the sign of all channels together apart."""
    sign = np.sign(found @ true)
    return float(np.mean((sign * found - true) ** 2) / bound**2)


def _ratio(case: str, method: str, name: str, squares: object, asked: tuple[float, float]) -> Figure:
    """Return the root of mean squared ratios with its standard error."""
    each = np.asarray(squares, dtype=float)
    each = each.reshape(len(each), -1).mean(axis=1)
    root = float(np.sqrt(each.mean()))
    return Figure(case, method, name, root, float(each.std(ddof=1) / np.sqrt(len(each)) / (2 * root)), asked)


def _largest(errors: object) -> float:
    return float(np.abs(np.asarray(errors)).max()) / RANGE_M


def _rms(errors: object) -> float:
    return float(np.sqrt(np.mean(np.square(np.asarray(errors)))))


CASES = (exact, dipole_at_the_coil, coil, calibrated, source_calibration, demodulation, passing)


@click.command(help=__doc__)
@click.option("--runs", default=500, show_default=True, help="Of each case.")
@click.option("--seed", default=2025, show_default=True, help="Of all random numbers.")
def main(runs: int, seed: int) -> None:
    """Run the benchmark."""
    figures = [
        figure for number, case in enumerate(CASES) for figure in case(np.random.default_rng((seed, number)), runs)
    ]
    table = Table("case", "method", "figure", "measured", "asked", "met", title=f"Localisation, {runs} runs")
    for figure in figures:
        spread = "" if np.isnan(figure.standard_error) else f" ± {figure.standard_error:.2g}"
        table.add_row(
            figure.case,
            figure.method,
            figure.name,
            f"{figure.value:.4g}{spread}",
            figure.asked_in_words,
            figure.verdict,
        )
    Console(width=170, markup=False).print(table)
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        lines = [
            f"# python benchmarks/localization.py --runs {runs} --seed {seed}",
            "case,method,figure,value,standard_error,asked,met",
        ]
        path.write_text("\n".join([*lines, *(figure.line for figure in figures)]) + "\n")


if __name__ == "__main__":
    main()
