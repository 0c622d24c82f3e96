"""Speed of the fits against the procedure that Wu 2025 publishes, on the same data, in one run.

Run ``python benchmarks/speed.py``. Both sides take the same recording and give the same: the errors of all sensors and
nothing else, ours by ``published_errors`` and ``maximum_likelihood.estimate``. The published procedure, sensor by
sensor: eq. 9 by its normal equations; eq. 12 by sequential quadratic programming (SLSQP of scipy, which finds its
slopes by differences as the paper states none) between bounds from the solution of eq. 9; eq. 13 by normal equations;
Procrustes analysis. It is made as quick as it can be without changing what it does: eq. 12 is one product with the
matrix K of eq. 10, readings are in units of the field, the objective in units of the noise, and it stops within a
hundredth of a standard error. Term by term as printed, eq. 12 takes two to three times as long.

The shape that eq. 9 gives is too large by 1 + oᵀ A o, which the paper does not say, and the programming starts there.
Beside it, unasked: started from the right shape, which is its minimum already; and the whole result of our methods,
with covariance, residuals, noise floor and coverage. Each is called in turn, and the ratio of their CPU times is taken
call by call.
"""

from collections.abc import Callable
from dataclasses import replace
from time import process_time

import click
import numpy as np
from numpy.linalg import inv, solve, svd
from rich.progress import track
from scipy.optimize import minimize
from spread import Row, show

from tam_calibration.fit import maximum_likelihood
from tam_calibration.fit.published import lossless
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_validation.papers.wu2025_sweeps import published_errors

SIZES = (360, 1_000, 10_000, 100_000)
METHODS: dict[str, Callable[[Recording, Array], object]] = {
    "lossless": lambda recording, array: published_errors(recording, as_published=False),
    "maximum_likelihood": maximum_likelihood.estimate,
    "lossless, whole result": lossless,
    "maximum_likelihood, whole result": maximum_likelihood.maximum_likelihood,
    "published, from its minimum": lambda recording, array: published(recording, from_minimum=True),
}
ASKED = {"lossless": 20.0, "maximum_likelihood": 5.0}
"""How many times as fast as the published fit each must be."""

NOISE_OVER_FIELD = 2e-5
"""Noise of the sensors of Wu 2025 over the field: 1 nT over 50 µT."""


@click.command(help=__doc__)
@click.option("--seconds", default=20.0, show_default=True, help="CPU time spent on each size.")
def main(seconds: float) -> None:
    """Run the benchmark."""
    rows = [row for size in track(SIZES, description="sizes") for row in compare(size, seconds)]
    title = "Fits: CPU time of the published procedure over ours"
    show(title, f"python benchmarks/speed.py --seconds {seconds:g}", "speed.csv", rows)


def compare(size: int, seconds: float) -> list[Row]:
    """Return for each method the ratio of the CPU times, and the times."""
    run = simulate(replace(read_scenario("wu_table_1"), sample_count=size))
    recording, array = run.recording, run.scenario.array
    calls = {"published": lambda: published(recording)} | {
        name: (lambda method=method: method(recording, array)) for name, method in METHODS.items()
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    while len(times["published"]) < 3 or sum(map(sum, times.values())) < seconds:
        for name, call in calls.items():
            times[name].append(_measure(call))
    case = f"{size} samples"
    rows = [
        Row(case, f"published over {name}", np.array(times["published"]) / np.array(times[name]), ASKED.get(name, 0.0))
        for name in METHODS
    ]
    return rows + [Row(case, f"{name}, ms", 1e3 * np.array(each)) for name, each in times.items()]


def _measure(call: Callable[[], object]) -> float:
    begin = process_time()
    call()
    return process_time() - begin


def published(recording: Recording, from_minimum: bool = False) -> SensorErrors:
    """Return the errors by Wu 2025 as printed."""
    assert recording.scalar_T is not None
    unit = float(recording.scalar_T.mean())
    intensity = recording.scalar_T / unit
    matrices, biases, fields = [], [], []
    for sensor in range(recording.sensor_count):
        readings = recording.readings_T[:, sensor] / unit
        bias = _published_bias(readings, from_minimum)
        unbiased = readings - bias
        design = _quadratic(unbiased)
        unmix = np.linalg.cholesky(_symmetric(solve(design.T @ design, design.T @ intensity**2))).T
        field = unbiased @ unmix.T
        fields.append(field)
        left, _, right = svd(field.T @ fields[0])
        matrices.append(inv(unmix) @ left @ right)
        biases.append(unit * bias)
    return SensorErrors.from_matrix(np.array(matrices), np.array(biases))


def _published_bias(readings: FloatArray, from_minimum: bool) -> FloatArray:
    """Return the bias of step 1: eq. 9, then eq. 12 in units of the sensors' noise, until it falls by 1e-9 no more."""
    design = np.column_stack([_quadratic(readings), -2 * readings])
    unknowns = solve(design.T @ design, design.sum(axis=0))
    bias = solve(_symmetric(unknowns), unknowns[6:])
    shape = unknowns[:6]
    if from_minimum:
        shape = shape / (1 + bias @ _symmetric(shape) @ bias)

    def mean_square(u: FloatArray) -> float:
        turned = _symmetric(u) @ u[6:]
        residual = design @ np.concatenate([u[:6], turned]) + (u[6:] @ turned - 1)
        return float(residual @ residual) / len(residual) / NOISE_OVER_FIELD**2

    start = np.concatenate([shape, bias])
    bounds = [(value - 1, value + 1) for value in start]
    found: FloatArray = minimize(mean_square, start, method="SLSQP", bounds=bounds, options={"ftol": 1e-9}).x
    return found[6:]


def _quadratic(points: FloatArray) -> FloatArray:
    x, y, z = points.T
    return np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)


def _symmetric(u: FloatArray) -> FloatArray:
    return np.array([[u[0], u[3], u[4]], [u[3], u[1], u[5]], [u[4], u[5], u[2]]])


if __name__ == "__main__":
    main()
