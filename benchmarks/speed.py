"""Speed of the fits against the procedure that Wu 2025 publishes, on the same data, in one run.

Run ``python benchmarks/speed.py``. The published procedure minimises eq. 12 over the samples by sequential quadratic
programming (SLSQP of scipy, which finds its slopes by differences), from the solution of eq. 9, sensor by sensor; then
eq. 13 and Procrustes analysis; it returns the errors alone. So does ``lossless.estimate``; the methods also return
covariance, residuals, noise floor and coverage. Each is called in turn, and the ratio of their CPU times is taken call
by call.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from time import process_time

import click
import numpy as np
from numpy.linalg import inv, lstsq, svd
from rich.console import Console
from rich.progress import track
from rich.table import Table
from scipy.optimize import minimize

from tam_calibration.errors import SensorErrors
from tam_calibration.files.scenario import read_scenario
from tam_calibration.files.whole import write_whole
from tam_calibration.fit.lossless import estimate, lossless
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.recording import Recording
from tam_calibration.simulation import simulate
from tam_calibration.units import FloatArray

SIZES = (360, 1_000, 10_000, 100_000)
ASKED = {"lossless, errors alone": 20.0, "maximum_likelihood": 5.0}
METHODS = {
    "lossless, errors alone": lambda recording, array: estimate(recording),
    "lossless": lossless,
    "maximum_likelihood": maximum_likelihood,
}
NOISE_OVER_FIELD = 2e-5
RESULTS = Path(__file__).parent / "results" / "speed.csv"


@click.command(help=__doc__)
@click.option("--seconds", default=20.0, show_default=True, help="CPU time spent on each size.")
def main(seconds: float) -> None:
    """Run the benchmark."""
    rows = [row for size in track(SIZES, description="sizes") for row in compare(size, seconds)]
    table = Table(title="CPU time of the published procedure over ours")
    for column in ("samples", "method", "published, ms", "ours, ms", "ratio", "10 % to 90 %", "asked"):
        table.add_column(column, justify="right")
    for size, method, published, ours, ratio, low, high in rows:
        spread, asked = f"{low:.1f} to {high:.1f}", f"≥ {ASKED[method]:.0f}" if method in ASKED else ""
        table.add_row(f"{size}", method, f"{published:.2f}", f"{ours:.2f}", f"{ratio:.1f}", spread, asked)
    Console().print(table)
    RESULTS.parent.mkdir(exist_ok=True)
    with write_whole(RESULTS) as path:
        header = "samples,method,published_ms,ours_ms,ratio,ratio_10_percent,ratio_90_percent"
        lines = [
            "# python benchmarks/speed.py",
            header,
            *(f'{row[0]},"{row[1]}",' + ",".join(map(str, row[2:])) for row in rows),
        ]
        path.write_text("\n".join(lines) + "\n")


def compare(size: int, seconds: float) -> list[tuple[int, str, float, float, float, float, float]]:
    """Return for each method the medians of the CPU times in ms and of their ratio, with its spread."""
    run = simulate(replace(read_scenario("wu_table_1"), sample_count=size))
    recording, array = run.recording, run.scenario.array
    calls = {"published": lambda: published(recording)} | {
        name: (lambda method=method: method(recording, array)) for name, method in METHODS.items()
    }
    times: dict[str, list[float]] = {name: [] for name in calls}
    while len(times["published"]) < 3 or sum(map(sum, times.values())) < seconds:
        for name, call in calls.items():
            times[name].append(_measure(call))
    rows = []
    for name in METHODS:
        ratios = np.array(times["published"]) / np.array(times[name])
        medians = (1e3 * float(np.median(times[each])) for each in ("published", name))
        rows.append((size, name, *medians, *(float(value) for value in np.quantile(ratios, [0.5, 0.1, 0.9]))))
    return rows


def _measure(call: Callable[[], object]) -> float:
    begin = process_time()
    call()
    return process_time() - begin


def published(recording: Recording) -> SensorErrors:
    """Return the errors by Wu 2025 as printed, sample by sample sums throughout."""
    assert recording.scalar_T is not None
    unit = float(recording.scalar_T.mean())
    intensity = recording.scalar_T / unit
    matrices, biases, fields = [], [], []
    for sensor in range(recording.sensor_count):
        readings = recording.readings_T[:, sensor] / unit
        bias = _published_bias(readings)
        unbiased = readings - bias
        x, y, z = unbiased.T
        q = lstsq(np.stack([x * x, y * y, z * z, 2 * x * y, 2 * y * z, 2 * x * z], 1), intensity**2, rcond=None)[0]
        unmix = np.linalg.cholesky(np.array([[q[0], q[3], q[5]], [q[3], q[1], q[4]], [q[5], q[4], q[2]]])).T
        field = unbiased @ unmix.T
        fields.append(field)
        left, _, right = svd(field.T @ fields[0])
        matrices.append(inv(unmix) @ left @ right)
        biases.append(unit * bias)
    return SensorErrors.from_matrix(np.array(matrices), np.array(biases))


def _published_bias(readings: FloatArray) -> FloatArray:
    """Return the bias of step 1: eq. 9, then eq. 12 in units of the sensors' noise, until it falls by 1e-9 no more."""
    x, y, z = readings.T
    quadratic = np.stack([x * x, y * y, z * z, 2 * x * y, 2 * x * z, 2 * y * z], axis=1)
    unknowns = lstsq(np.column_stack([quadratic, -2 * readings]), np.ones(len(readings)), rcond=None)[0]
    bias = np.linalg.solve(_symmetric(unknowns), unknowns[6:])
    shape = unknowns[:6] / (1 + bias @ _symmetric(unknowns) @ bias)
    xx, yy, zz, xy, xz, yz = x * x, y * y, z * z, x * y, x * z, y * z

    def mean_square(u: FloatArray) -> float:
        u1, u2, u3, u4, u5, u6, u7, u8, u9 = u
        cross = xy * u4 + xz * u5 + yz * u6 - x * u1 * u7 - y * u2 * u8 - z * u3 * u9 - x * u4 * u8 - y * u4 * u7
        cross = cross - x * u5 * u9 - z * u5 * u7 - z * u6 * u8 - y * u6 * u9
        cross = cross + u4 * u7 * u8 + u5 * u7 * u9 + u6 * u8 * u9
        residual = xx * u1 + yy * u2 + zz * u3 + 2 * cross + u1 * u7**2 + u2 * u8**2 + u3 * u9**2 - 1
        return float(np.mean(residual**2)) / NOISE_OVER_FIELD**2

    start = np.concatenate([shape, bias])
    bounds = [(value - 1, value + 1) for value in start]
    found: FloatArray = minimize(mean_square, start, method="SLSQP", bounds=bounds, options={"ftol": 1e-9}).x
    return found[6:]


def _symmetric(u: FloatArray) -> FloatArray:
    return np.array([[u[0], u[3], u[4]], [u[3], u[1], u[5]], [u[4], u[5], u[2]]])


if __name__ == "__main__":
    main()
