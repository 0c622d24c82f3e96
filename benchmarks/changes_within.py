"""Updates of recordings within which something moves: what is told, and whether the calibration after it holds.

Run ``python benchmarks/changes_within.py [--runs 100]``. Wu's array, 1 nT and 0.1 nT of noise. The prior is what a full
turn tells, two hours before; the true errors are drawn from it. Then some of them move by 10 nT to 10 µT, or as much of
the field, after 5 to 95 % of 600 samples: one of the four kinds of one sensor, all four kinds of one sensor, the biases
of two or of all, or the scale of all against the scalar's; or a bias, or all, move and are later what they were. The
array turns by ±5 to 30° of pitch and roll, or rests in attitudes all round; the noise is stated or not. Figures:

- told: all that moved is among what is told, or the first that is told has it for a rival, and its time is right to a
  hundredth of the recording;
- nothing else told;
- errors within their 95 % intervals after the change, and their root mean square over their standard errors;
- refused: neither the prior nor the samples after the change tell enough.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import click
import numpy as np
from asked import Figure, show
from mission import DIVE_S, PIER_S, WITHIN_95, drawn, pier, scenario_of
from rich.console import Console
from rich.progress import track

from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import COMMON_SCALE, KINDS
from tam_calibration.files.text_files import write_whole
from tam_calibration.fit import calibrate
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import Manoeuvre

RESULTS = Path(__file__).parent / "results" / "changes_within.csv"
COUNT, RATE_HZ = 600, 10.0
"""A minute, in which a vehicle turns by half a circle, at the rate of a survey's fluxgates."""

WHEN = (0.05, 0.95)
"""Part of the recording after which something moves."""

SIZES_T = from_nanotesla(np.array([10.0, 10_000.0]))
"""Smallest and largest change of a reading."""

TILTS_DEG = (5.0, 30.0)
"""Limits of pitch and roll, from a vehicle that hardly tilts to one that does."""

TURNS, STATED = 0.75, 0.75
"""Part of the recordings that are turns, and whose noise is stated."""

CASES: dict[str, tuple[tuple[str, ...], int]] = {
    **{kind: ((kind,), 1) for kind in KINDS},
    "all errors of a sensor": (KINDS, 1),
    "biases of two sensors": (("bias",), 2),
    "biases of all sensors": (("bias",), 4),
    COMMON_SCALE: (("scale factor",), 4),
    "a bias, and back": (("bias",), 1),
    "biases of all sensors, and back": (("bias",), 4),
}
"""Kinds of errors that move, and of how many sensors."""

BACK = ("a bias, and back", "biases of all sensors, and back")
"""As a tool that is picked up and dropped."""

ASKED = (0.93, 0.97)
"""Errors within their 95 % intervals, as of all updates."""


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one recording; ``pulls``, the errors over their standard errors, is None where it was refused."""

    is_told: bool = False
    is_told_alone: bool = False
    pulls: FloatArray | None = None


def changed(
    case: str, errors: SensorErrors, intensity_T: float, generator: np.random.Generator
) -> tuple[SensorErrors, set[tuple[str, int]]]:
    """Return errors of which some have moved, and the kinds and sensors of these."""
    kinds, count = CASES[case]
    size_T, vector = np.exp(generator.uniform(*np.log(SIZES_T))), errors.to_vector()
    sensors = generator.permutation(4)[:count].tolist()
    for sensor in sensors:
        for kind in kinds:
            direction, place = generator.standard_normal(3), 3 * KINDS.index(kind)
            change = (size_T if kind == "bias" else size_T / intensity_T) * direction / np.linalg.norm(direction)
            if case == COMMON_SCALE:
                change = size_T / intensity_T * vector[sensor, :3]
            vector[sensor, place : place + 3] += change
    return in_first_frame(SensorErrors.from_vector(vector))[0], {(kind, each + 1) for kind in kinds for each in sensors}


def recorded(
    scenario: Scenario, before: SensorErrors, after: SensorErrors, changed: slice, generator: np.random.Generator
) -> Recording:
    """Return a recording of a turn, or of attitudes all round, of which the errors are others in some samples."""
    common = replace(scenario, sample_count=COUNT, rate_hz=RATE_HZ, seed=int(generator.integers(2**31)))
    if generator.random() < TURNS:
        limit = from_degrees(generator.uniform(*TILTS_DEG))
        common = replace(common, motion=Manoeuvre(limit, limit, 120.0))
    early, late = (simulate(replace(common, errors=each)).recording for each in (before, after))
    readings = early.readings_T.copy()
    readings[changed] = late.readings_T[changed]
    return replace(early, time_s=PIER_S + DIVE_S + early.time_s, readings_T=readings)


def outcome(case: str, seed: int, calibration: Calibration) -> Outcome:
    """Return what becomes of one recording."""
    scenario, generator = scenario_of(4), np.random.default_rng([seed, 13])
    before = drawn(prior_of(calibration, PIER_S + DIVE_S, None), generator)
    after, parts = changed(case, before, calibration.intensity_T, generator)
    count = 2 if case in BACK else 1
    moves = sorted((COUNT * generator.uniform(*WHEN, size=count)).astype(int).tolist())
    recording = recorded(scenario, before, after, slice(moves[0], moves[1] if count == 2 else None), generator)
    after = before if count == 2 else after
    array = scenario.array if generator.random() < STATED else Array(scenario.array.positions_m)
    try:
        found = calibrate(recording, array, prior=calibration)
    except (InputError, Refused):
        return Outcome()
    assert found.update is not None
    free = found.standard_errors > 0
    pulls = (found.errors.to_vector() - after.to_vector())[free] / found.standard_errors[free]
    told = {(each.kind, each.sensor) for each in found.update.moved}
    rivals = set(found.update.moved[0].rivals) if found.update.moved else set()
    since_s = sorted({each.since_s for each in found.update.moved if each.since_s is not None})
    is_timely = len(since_s) == len(moves) and all(np.abs(since_s - recording.time_s[moves]) <= COUNT / RATE_HZ / 100)
    return Outcome(is_timely and (parts <= told or parts <= rivals), told == parts, pulls)


def figures_of(case: str, outcomes: list[Outcome]) -> list[Figure]:
    """Return the figures of a kind of change."""
    pulls = [each.pulls for each in outcomes if each.pulls is not None]
    within = np.array([np.mean(np.abs(each) < WITHIN_95) for each in pulls])
    squares = np.array([np.mean(np.square(each)) for each in pulls])
    root = float(np.sqrt(squares.mean()))
    spread = squares.std(ddof=1) / np.sqrt(len(squares)) / 2 / root
    return [
        Figure(case, "update", "told", float(np.mean([each.is_told for each in outcomes]))),
        Figure(case, "update", "nothing else told", float(np.mean([each.is_told_alone for each in outcomes]))),
        Figure(
            case, "update", "within 95 %", float(within.mean()), float(within.std(ddof=1) / np.sqrt(len(within))), ASKED
        ),
        Figure(case, "update", "errors over standard errors, rms", root, float(spread)),
        Figure(case, "update", "refused", 1 - len(pulls) / len(outcomes)),
    ]


@click.command(help=__doc__)
@click.option("--runs", default=100, show_default=True, help="Simulated recordings of each kind of change.")
@click.option("--first-seed", default=10_000, show_default=True, help="Seed of the first one.")
def main(runs: int, first_seed: int) -> None:
    """Run the benchmark."""
    calibration = pier(scenario_of(4))
    figures: list[Figure] = []
    for place, case in enumerate(track(CASES, "kinds of change", console=Console(stderr=True))):
        first = first_seed + 1000 * place
        figures += figures_of(case, [outcome(case, seed, calibration) for seed in range(first, first + runs)])
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        command = f"# python benchmarks/changes_within.py --runs {runs} --first-seed {first_seed}"
        header = "case,method,figure,value,standard_error,asked,met"
        path.write_text("\n".join([command, header, *(figure.line for figure in figures)]) + "\n")
    show(figures, f"Changes within a recording, {runs} runs of each", "method")


if __name__ == "__main__":
    main()
