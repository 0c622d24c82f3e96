"""Survey lines by ``find_targets`` and by Euler deconvolution of the intensity, side by side.

Run ``python benchmarks/survey_euler.py [--lines 5] [--seed 100] [--kind plain]``. The lines are those of
``survey_lines``. Euler deconvolution is that of harmonica (structural index 3), in windows of 12 m along the line, on
the intensity's anomaly and its derivatives, which the array measures. Its windows have their middle at the true
targets, so that it has nothing to detect. A target is found within half its distance. Without harmonica nothing is
compared; Euler inversion is in no published version of it.
"""

from collections.abc import Callable
from importlib import import_module
from typing import Any

import click
import numpy as np
from asked import ANYTHING, Figure, show
from numpy.linalg import norm
from survey_lines import STRONG, calibrated, compared
from survey_simulator import KINDS, Truth, line_of

from tam_calibration.localization.targets import find_targets, path_in
from tam_calibration.model.array import Array, tensors_of
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_HALF_M = 6.0
"""Half of a window, metres: some three depths of a target together."""


def euler_errors(
    make: Callable[[int], Any], recording: Recording, array: Array, truth: Truth
) -> list[tuple[float, bool]]:
    """Return how far Euler's solutions are from the targets that are asked for, metres, and whether these are found."""
    assert recording.attitude is not None and recording.position_m is not None
    from scipy.spatial.transform import Rotation

    outputs = recording.readings_T.reshape(recording.sample_count, -1) @ array.operator.T
    turn = Rotation.from_quat(recording.attitude).as_matrix()
    intensity = norm(outputs[:, :3], axis=1)
    slopes = np.einsum("nij,njk,nk->ni", turn, tensors_of(outputs), outputs[:, :3] / intensity[:, None])
    errors = []
    for place, signal in zip(truth.position_m, truth.signal, strict=True):
        near = np.abs(recording.position_m[:, 0] - place[0]) < _HALF_M
        if signal < STRONG or near.sum() < 10:
            continue
        data = (intensity[near] - np.median(intensity), *slopes[near].T)
        found: FloatArray = make(3).fit(tuple(recording.position_m[near].T), data).location_
        error = float(norm(found - place))
        errors.append((error, error < 0.5 * float(norm(truth.path_m - place, axis=1).min())))
    return errors


@click.command(help=__doc__)
@click.option("--lines", default=5, show_default=True, help="Lines.")
@click.option("--seed", default=100, show_default=True, help="Of the first line.")
@click.option("--kind", type=click.Choice(list(KINDS)), default="plain", show_default=True, help="Kind of the lines.")
def command(lines: int, seed: int, kind: str) -> None:
    """Print how far both are from the targets."""
    try:
        make = import_module("harmonica").EulerDeconvolution
    except ImportError:
        click.echo("skipped: harmonica is not installed; .venv/bin/pip install -e '.[bench]'")
        return
    euler: list[tuple[float, bool]] = []
    asked = found = 0
    own: list[float] = []
    for number in range(seed, seed + lines):
        recording, array, truth = line_of(kind, number)
        euler += euler_errors(make, recording, array, truth)
        asked += int((truth.signal >= STRONG).sum())
        path = path_in(recording, position_error_m=truth.error_m, position_drift_m=truth.drift_m)
        try:
            targets = find_targets(recording, calibrated(array, number, False), path, truth.attitude).targets
        except Refused:
            continue
        counts, _ = compared(targets, truth)
        found += counts["found"]
        own += [float(norm(truth.position_m - each.position_m, axis=1).min()) for each in targets]
    rows = [
        ("harmonica", "median error [m]", float(np.median([error for error, _ in euler])) if euler else np.nan),
        ("harmonica", "found share", sum(is_found for _, is_found in euler) / max(asked, 1)),
        ("find_targets", "median error [m]", float(np.median(own)) if own else np.nan),
        ("find_targets", "found share", found / max(asked, 1)),
    ]
    show([Figure(kind, by, what, value, asked=ANYTHING) for by, what, value in rows], f"{lines} lines", "by")


if __name__ == "__main__":
    command()
