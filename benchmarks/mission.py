"""Calibration during a mission: how near the fit of a prior and a narrow turn comes to the best that is possible.

Run ``python benchmarks/mission.py [--runs 100]``. Wu's array, 1 nT and 0.1 nT of noise. The prior is what 3000 samples
over the whole sphere tell, a day old; the true errors are drawn from it, so that the least mean square error is that of
the Bayesian Cramér-Rao bound: the inverse of the information of prior and data, taken at the truth without noise.
Full circles of yaw, pitch and roll up to the tilt limit, attitude with white noise and an unknown mounting. Figures:

- RMSE/bound, the root of the mean over runs and parameters of the squared error over its bound;
- the part of all errors within the 95 % intervals that the fit tells;
- after a bias of 5 nT in any direction moved since the pier, two hours ago, and 300 samples of a turn by 90° with ±5°
  of pitch and roll: tensor and centre field at ±30° over the noise floor, root mean square over the runs; how often the
  change was found, and named rightly; the same of a scale factor and of angles that move by as much as 20 nT of the
  field;
- turns of full circles at ±3° that ``tam calibrate`` refuses without a prior, and with one.

Cases of 100 000 samples are run less often, a twentieth of the times and four at least, and not with the middle noise
of the attitude.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from asked import ANYTHING, Figure, show
from scipy.spatial.transform import Rotation

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import KINDS
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import calibrate
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import Prior, in_first_frame, prior_of
from tam_calibration.fit.prior_changes import update_prior
from tam_calibration.fit.problem import Known, Place, Problem, posterior_of
from tam_calibration.model.array import Array
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import AttitudeChannel, Manoeuvre

RESULTS = Path(__file__).parent / "results" / "mission.csv"
TILTS_DEG = (5.0, 10.0, 20.0, 30.0)
"""Limits of pitch and roll, from a vehicle that hardly tilts to one that does."""

ATTITUDE_NOISES_DEG = (0.05, 0.2, 1.0)
"""From a gyrocompass to a cheap inertial sensor."""

COUNTS = (300, 3000, 100_000)
LARGE, PART_OF_RUNS = 100_000, 20
PIER_SAMPLES = 3000
PIER_S = 1.76e9
"""Stamp of the full turn: any that is a date."""

DIVE_S = 7200.0
"""From the full turn to the dive in which a sensor has changed, seconds."""

WITHIN_95 = 1.959964
"""Standard errors within which 95 % of normal errors lie."""

BIAS_T, OTHER_T = from_nanotesla(5.0), from_nanotesla(20.0)
"""Change of a bias; and change of a reading by another error, as much as a narrow turn can show."""

MOUNT = Rotation.from_rotvec(from_degrees(np.array([3.0, -5.0, 20.0])))
"""How the attitude's sensor is turned: by no small angle."""


def scenario_of(sensors: int) -> Scenario:
    """Return Wu's scenario, of all four sensors or the first."""
    scenario = read_scenario("wu_table_1")
    if sensors == 4:
        return scenario
    whole = scenario.array.with_stated_noise()
    array = Array(whole.positions_m[:1], whole.vector_noise_T[:1], whole.scalar_noise_T)
    return replace(scenario, array=array, errors=SensorErrors.from_vector(scenario.errors.to_vector()[:1]))


def pier(scenario: Scenario) -> Calibration:
    """Return the calibration of the whole sphere, with a date."""
    made = simulate(replace(scenario, sample_count=PIER_SAMPLES, seed=0)).recording
    return maximum_likelihood(replace(made, time_s=PIER_S + made.time_s), scenario.array)


def drawn(prior: Prior, generator: np.random.Generator) -> SensorErrors:
    """Return errors that are as probable as the prior says."""
    size = np.sqrt(np.diag(prior.covariance))
    held = size == 0
    correlation = prior.covariance / np.outer(*2 * (np.where(held, 1.0, size),))
    values, vectors = np.linalg.eigh(correlation)
    deviation = size * (vectors @ (np.sqrt(np.maximum(values, 0)) * generator.standard_normal(len(values))))
    return SensorErrors.from_vector(prior.errors.to_vector() + deviation.reshape(-1, 12), prior.errors.orientation)


@dataclass(frozen=True)
class Case:
    """Sensors, tilt limit, attitude noise and samples of a mission."""

    sensors: int
    tilt_deg: float
    attitude_deg: float
    count: int

    @property
    def name(self) -> str:
        """What it is called in the table."""
        return f"{self.sensors} sensors, ±{self.tilt_deg:g}°, attitude {self.attitude_deg:g}°, {self.count} samples"

    def turned(self, scenario: Scenario, errors: SensorErrors, seed: int, is_silent: bool = False) -> Recording:
        """Return the recording of a turn, its attitude mounted turned; silent without any noise."""
        noise = 0.0 if is_silent else from_degrees(self.attitude_deg)
        array = scenario.array
        if is_silent:
            array = replace(array, vector_noise_T=None, scalar_noise_T=None)
        limit = from_degrees(self.tilt_deg)
        motion = Manoeuvre(limit, limit, self.count / 50)
        made = simulate(
            replace(
                scenario,
                array=array,
                errors=errors,
                motion=motion,
                sample_count=self.count,
                rate_hz=10.0,
                attitude=AttitudeChannel(noise),
                seed=seed,
            )
        ).recording
        return replace(made, attitude=(Rotation.from_quat(made.attitude) * MOUNT).as_quat())


def score(case: Case, scenario: Scenario, prior: Prior, seed: int) -> tuple[FloatArray, FloatArray]:
    """Return the errors of a run over their bound, and over what the fit tells."""
    truth = drawn(prior, np.random.default_rng([seed, 7]))
    array = replace(scenario.array.with_stated_noise(), attitude_noise=from_degrees(case.attitude_deg))
    found = posterior_of(case.turned(scenario, truth, seed), array, Known(prior))
    known = Known(prior, start=Place(truth, prior.calibration.intensity_T))
    silent = Problem.of(case.turned(scenario, truth, seed, is_silent=True), array, known)
    there = silent.start
    information = silent.normal_at(there).information
    size = 12 * case.sensors
    least = np.sqrt(np.diag(inverted(information, silent.basis_at(there)))[:size])
    error = (found.errors.to_vector() - truth.to_vector()).ravel()
    told = np.sqrt(np.diag(found.covariance))
    free = least > 0
    return error[free] / least[free], error[free] / told[free]


def bound_figures(case: Case, runs: int, first_seed: int) -> tuple[list[Figure], FloatArray, FloatArray]:
    """Return the figures of a case, and its squared ratios (runs,) and errors within 95 % (runs,)."""
    scenario = scenario_of(case.sensors)
    prior = prior_of(pier(scenario), PIER_S + DAY_S, None)
    count = max(4, runs // PART_OF_RUNS) if case.count == LARGE else runs
    scores = [score(case, scenario, prior, first_seed + seed) for seed in range(count)]
    squares = np.array([np.mean(ratio**2) for ratio, _ in scores])
    within = np.array([np.mean(np.abs(told) < WITHIN_95) for _, told in scores])
    return [_ratio(case.name, squares, ANYTHING), _within(case.name, within, ANYTHING)], squares, within


def _ratio(name: str, squares: FloatArray, asked: tuple[float, float]) -> Figure:
    root = float(np.sqrt(squares.mean()))
    return Figure(
        name, "prior and data", "RMSE/bound", root, float(squares.std(ddof=1) / np.sqrt(len(squares)) / 2 / root), asked
    )


def _within(name: str, within: FloatArray, asked: tuple[float, float]) -> Figure:
    spread = float(within.std(ddof=1) / np.sqrt(len(within)))
    return Figure(name, "prior and data", "within 95 %", float(within.mean()), spread, asked)


def moved_figures(kind: str, runs: int, first_seed: int) -> Iterable[Figure]:
    """Yield what becomes of an array of which errors of a kind of one sensor moved by a given size."""
    scenario = scenario_of(4)
    calibration = pier(scenario)
    array, limit, work = scenario.array, from_degrees(5.0), from_degrees(30.0)
    size = BIAS_T if kind == "bias" else OTHER_T / calibration.intensity_T
    ratios, named = [], Counter[str]()
    for seed in range(first_seed, first_seed + runs):
        generator = np.random.default_rng([seed, 11])
        sensor, direction = int(generator.integers(4)), generator.standard_normal(3)
        vector, place = scenario.errors.to_vector(), 3 * KINDS.index(kind)
        vector[sensor, place : place + 3] += size * direction / np.linalg.norm(direction)
        errors, _ = in_first_frame(SensorErrors.from_vector(vector))
        begin = replace(scenario, errors=errors, rate_hz=10.0)
        turn = simulate(
            replace(begin, motion=Manoeuvre(limit, limit, 120.0), sample_count=300, rate_hz=10.0, seed=seed)
        ).recording
        turn = replace(turn, time_s=PIER_S + DIVE_S + turn.time_s)
        prior = prior_of(calibration, float(turn.time_s[0]), None)
        resolved = update_prior(turn, array, Known(prior))
        found = maximum_a_posteriori(resolved.recording, array, resolved.known)
        seen = simulate(
            replace(begin, motion=Manoeuvre(work, work, 120.0), sample_count=2400, rate_hz=10.0, seed=seed + 500_000)
        ).recording
        after, before, floor = (
            measure_residuals(each, array, seen, calibration.intensity_T)
            for each in (found.errors, calibration.errors, errors)
        )
        ratios.append(
            [each.tensor_rmse_T_per_m / floor.tensor_rmse_T_per_m for each in (after, before)]
            + [each.center_intensity_T / floor.center_intensity_T for each in (after, before)]
        )
        first = resolved.moved[0] if resolved.moved else None
        named["none" if first is None else first.kind if first.sensor == sensor + 1 else "another sensor"] += 1
    name = f"{kind} moved by {'5 nT' if kind == 'bias' else '20 nT of the field'}"
    asked = {"tensor": (0.0, 1.05), "centre": (0.0, 1.5)} if kind == "bias" else {}
    tensor, tensor_before, centre, centre_before = np.sqrt(np.mean(np.square(ratios), axis=0))
    for what, value, old in (("tensor", tensor, tensor_before), ("centre", centre, centre_before)):
        yield Figure(name, "after", f"{what}/floor at ±30°", float(value), asked=asked.get(what, ANYTHING))
        yield Figure(name, "before", f"{what}/floor at ±30°", float(old))
    for what in (*KINDS, "another sensor", "none"):
        limit_of = (0.0, 0.05) if what == "bias" and kind != "bias" else ANYTHING
        yield Figure(name, "told", what, named[what] / runs, asked=limit_of)


def narrow_figures(runs: int, first_seed: int) -> Iterable[Figure]:
    """Yield how many full circles at ±3° are refused."""
    scenario = scenario_of(4)
    calibration = pier(scenario)
    limit = from_degrees(3.0)
    for method, prior in (("plain", None), ("prior and data", calibration)):
        refused = 0
        for seed in range(first_seed, first_seed + runs):
            made = simulate(replace(scenario, motion=Manoeuvre(limit, limit, 60.0), rate_hz=5.0, seed=seed)).recording
            try:
                calibrate(replace(made, time_s=PIER_S + DIVE_S + made.time_s), scenario.array, prior=prior)
            except (InputError, Refused):
                refused += 1
        asked = ANYTHING if prior is None else (0.0, 0.0)
        yield Figure("full circles at ±3°", method, "refused", refused / runs, asked=asked)


@click.command(help=__doc__)
@click.option("--runs", default=100, show_default=True, help="Simulated recordings of each case.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
def main(runs: int, first_seed: int) -> None:
    """Run the benchmark."""
    figures: list[Figure] = []
    for kind in KINDS:
        figures += moved_figures(kind, runs, first_seed)
    figures += narrow_figures(max(3, runs // 10), first_seed)
    for sensors in (4, 1):
        for count in COUNTS:
            noises = ATTITUDE_NOISES_DEG[::2] if count == LARGE else ATTITUDE_NOISES_DEG
            cases = [Case(sensors, tilt, noise, count) for tilt in TILTS_DEG for noise in noises]
            # Truths of their own: those of all cases of a pool are then independent.
            parts = [bound_figures(case, runs, first_seed + 1000 * place) for place, case in enumerate(cases)]
            figures += [figure for part in parts for figure in part[0]]
            pooled = f"{sensors} sensors, {count} samples, all tilts and attitudes"
            squares, within = (np.concatenate([part[index] for part in parts]) for index in (1, 2))
            figures += [_ratio(pooled, squares, (0.0, 1.05)), _within(pooled, within, (0.93, 0.97))]
            keep(figures, runs, first_seed)
    show(figures, f"During a mission, {runs} runs", "method")


def keep(figures: list[Figure], runs: int, first_seed: int) -> None:
    """Write the figures that there are."""
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"python benchmarks/mission.py --runs {runs} --first-seed {first_seed}"
        header = "case,method,figure,value,standard_error,asked,met"
        path.write_text("\n".join([f"# {command}", header, *(figure.line for figure in figures)]) + "\n")


if __name__ == "__main__":
    main()
