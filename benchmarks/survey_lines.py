"""Whether the targets of a survey line are found, where they are, and what they cost.

Run ``python benchmarks/survey_lines.py [--lines 20] [--seed 100] [--judged]``: lines of 200 m past 1 to 12 targets, see
``survey_simulator``. A target counts as found where one of the answer is within half its distance, or its standard
errors.
"""

from collections import Counter
from dataclasses import replace
from pathlib import Path
from time import process_time

import click
import numpy as np
from asked import Figure, show
from numpy.linalg import norm
from scipy.spatial.transform import Rotation
from survey_simulator import EARTH_T, KINDS, NOISE_T, Truth, line_of

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit import calibrate
from tam_calibration.localization.targets import Target, find_targets, path_in
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors

RESULTS = Path(__file__).parent / "results"
STRONG = 5.0
"""Field of a target along the path, over the noise, from which it is asked for."""


def compared(targets: list[Target], truth: Truth) -> tuple[Counter[str], list[float]]:
    """Return counts of a line, and the errors of its dipoles over their standard errors."""
    counts: Counter[str] = Counter()
    deviations: list[float] = []
    taken: set[int] = set()
    places = np.array([each.position_m for each in targets]).reshape(-1, 3)
    for place, is_extended, signal in zip(truth.position_m, truth.is_extended, truth.signal, strict=True):
        if signal < STRONG:
            continue
        counts["asked"] += 1
        away = norm(places - place, axis=1)
        order = [each for each in np.argsort(away) if each not in taken][:1]
        for number in order:
            target = targets[number]
            reach = max(0.5 * target.distance_m, 3.0 * float(norm(target.standard_errors_m)))
            if away[number] < reach:
                taken.add(int(number))
                counts["found"] += 1
                counts["extended found"] += int(is_extended and target.is_extended)
                counts["extended told as dipole"] += int(is_extended and not target.is_extended)
                counts["dipole told as extended"] += int(target.is_extended and not is_extended)
                if not target.is_extended:
                    deviations += ((target.position_m - place) / target.standard_errors_m).tolist()
    counts["false"] += len(targets) - len(taken)
    counts["extended"] += int(truth.is_extended.sum())
    return counts, deviations


def calibrated(array: Array, seed: int, has_errors: bool) -> Calibration:
    """Return the calibration of an array from 400 turns in the Earth's field, or one without errors."""
    generator = np.random.default_rng(seed)
    turns = Rotation.random(400, random_state=seed)
    fields = np.repeat(turns.inv().apply(EARTH_T)[:, None], array.sensor_count, axis=1)
    readings = fields + NOISE_T * generator.standard_normal(fields.shape)
    scalar = norm(EARTH_T) + NOISE_T * generator.standard_normal(400)
    recording = Recording(np.arange(400.0), readings, scalar)
    calibration = calibrate(recording, replace(array, scalar_noise_T=NOISE_T))
    if has_errors:
        return calibration
    exact = np.zeros_like(calibration.covariance)
    return replace(calibration, errors=SensorErrors.none(array.sensor_count), covariance=exact)


@click.command()
@click.option("--lines", default=20, help="Lines of each kind.")
@click.option("--seed", default=100, help="Of the first line.")
@click.option("--judged", is_flag=True, help="Lines with other physics, for which no rule was made.")
@click.option("--kind", multiple=True, help="Kinds; by default all without a gyroscope.")
@click.option("--without-gyroscope", is_flag=True, help="Leave the angular velocity out.")
@click.option("--calibration-errors", is_flag=True, help="Calibrate the array from 400 turns first.")
@click.option("--verbose", is_flag=True, help="Print each line.")
def command(
    lines: int,
    seed: int,
    judged: bool,
    kind: tuple[str, ...],
    without_gyroscope: bool,
    calibration_errors: bool,
    verbose: bool,
) -> None:
    """Print the figures of survey lines."""
    figures: list[Figure] = []
    for name in kind or [each for each in KINDS if each != "gyroscope"]:
        total: Counter[str] = Counter()
        deviations: list[float] = []
        seconds = 0.0
        for number in range(seed, seed + lines):
            recording, array, truth = line_of(name, number, judged)
            if without_gyroscope:
                recording = replace(recording, angular_velocity_rad_s=None)
            calibration = calibrated(array, number, calibration_errors)
            begun = process_time()
            try:
                path = path_in(recording, position_error_m=truth.error_m, position_drift_m=truth.drift_m)
                targets = find_targets(recording, calibration, path, truth.attitude).targets
            except Refused:
                total.update(refused=1, asked=int((truth.signal >= STRONG).sum()))
                continue
            finally:
                seconds += process_time() - begun
            counts, own = compared(targets, truth)
            total += counts
            deviations += own
            if verbose:
                print(
                    name,
                    number,
                    dict(counts),
                    np.abs(own).max() if own else 0,
                    f"{process_time() - begun:.1f} s",
                    flush=True,
                )
        sizes = np.abs(deviations)
        asked = total["asked"]
        case = f"{name}{', judged' if judged else ''}"
        rows: list[tuple[str, float, int, tuple[float, float]]] = [
            ("found share", total["found"], asked, (0.95, 1.0)),
            ("false targets a line", total["false"], lines, (0.0, 0.05)),
            ("95 % intervals cover", int(np.sum(sizes < 1.96)), len(sizes), (0.93, 0.97)),
            ("beyond 5 standard errors", int(np.sum(sizes > 5)), len(sizes), (0.0, 0.001)),
            ("refused", total["refused"], lines, (0.0, 0.05)),
            ("seconds a metre", seconds / 200, lines, (0.0, 0.05)),
            ("dipoles told as extended", total["dipole told as extended"], asked, (0.0, 0.05)),
            ("extended told as dipoles", total["extended told as dipole"], total["extended"], (0.0, 0.0)),
        ]
        figures += [Figure(case, "targets", what, n / of, asked=bounds) for what, n, of, bounds in rows if of]
        parts = "judged" if judged else "made", *kind, *(["without_gyroscope"] if without_gyroscope else [])
        (RESULTS / f"survey_lines_{'_'.join(parts)}.csv").write_text("\n".join(each.line for each in figures) + "\n")
    show(figures, f"{lines} lines of 200 m of each kind, seeds from {seed}", "by")


if __name__ == "__main__":
    command()
