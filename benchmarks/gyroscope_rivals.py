"""The biases that other methods find next to ours, from the same recordings with a gyroscope and without a scalar.

Run ``python benchmarks/gyroscope_rivals.py [--runs 20] [--seed 1]``. MAGYC is the public code of Rodríguez-Martínez and
others (arXiv 2410.13827, 2412.09690): it is left out where the package magyc from PyPI is not installed. The joint
calibration of Huang, Hendeby and Skog (arXiv 2505.16662) is our reading of the paper and of its MATLAB code
(github.com/Huang-Chuan/Mag-IMU-JointCalibration): attitudes of all samples, matrix and bias of the magnetometer, dip,
and biases of gyroscope and accelerometer are one least-squares problem. It takes an accelerometer that is at rest but
for turns, which ours does not take, and it begins at the true values, so that no start is to blame.
"""

from collections.abc import Callable
from functools import partial
from time import process_time
from typing import Any

import click
import numpy as np
from gyroscope import jointly
from gyroscope_cases import DIP, FIELD_T, Case
from numpy.linalg import norm
from rich.progress import track
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import splu
from scipy.spatial.transform import Rotation
from spread import Row, show

from tam_calibration.model.units import FloatArray, from_degrees, to_nanotesla

RIVALS = ("magyc_ls", "magyc_nls", "magyc_ifg")
"""Its methods: linear, non-linear, and a factor graph."""


GRAVITY, ACCELEROMETER, ACCELEROMETER_BIAS = 9.81, 0.02, 0.05
"""m/s²: noise of a sample of a good chip, and standard deviation of its bias."""

STEPS = 10
"""Of Gauss and Newton: from the true values four were enough."""


def answers(case: Case, seed: int) -> dict[str, tuple[float, float]]:
    """Return the error of the bias by each method, nT, and the time of the processor that it took, seconds."""
    recording, errors = case.made(seed)
    methods: dict[str, Callable[[], FloatArray]] = {
        "this package": lambda: jointly(recording, case.array).errors.to_vector()[0, 6:9],
        "joint MAP (Huang 2026)": lambda: JointMap(case, seed).bias_T(),
    }
    try:
        import magyc
    except ImportError:
        pass
    else:
        # In microtesla: its solvers are not scaled.
        data = 1e6 * recording.readings_T[:, 0], recording.angular_velocity_rad_s, recording.time_s
        for name in RIVALS:
            methods[name] = partial(_bias_T, getattr(magyc, name), data)
    found = {}
    for name, method in methods.items():
        begin = process_time()
        away_T = norm(method() - errors.to_vector()[0, 6:9])
        found[name] = to_nanotesla(float(away_T)), process_time() - begin
    return found


def _bias_T(solver: Callable[..., Any], data: tuple[FloatArray | None, ...]) -> FloatArray:
    return 1e-6 * np.ravel(solver(*data)[0])


class JointMap:
    """The least-squares problem of Huang, Hendeby and Skog; the field is its unit, north and up its world."""

    def __init__(self, case: Case, seed: int) -> None:
        recording, errors = case.made(seed)
        assert case.rate_deg_s is not None and recording.angular_velocity_rad_s is not None
        rng, self.time_s = np.random.default_rng([seed, 7]), recording.time_s
        self.readings = recording.readings_T[:, 0] / FIELD_T
        self.attitude = case.attitude(self.time_s)
        up = self.attitude.inv().apply([0.0, 0.0, GRAVITY])
        self.force = up + rng.normal(0, ACCELEROMETER, up.shape) + rng.normal(0, ACCELEROMETER_BIAS, 3)
        rates, interval_s = recording.angular_velocity_rad_s, np.diff(self.time_s)[:, None]
        # The paper integrates readings of a higher rate; of these the spline is as good, with the coning correction.
        integral = CubicSpline(self.time_s, rates).antiderivative()(self.time_s)
        self.turns = np.diff(integral, axis=0) + np.cross(rates[:-1], rates[1:]) * interval_s**2 / 12
        self.interval_s = interval_s
        # The mean of two readings has half of the variance of one.
        self.turn_noise = from_degrees(case.rate_deg_s) * float(interval_s[0, 0]) / np.sqrt(2)
        self.matrix = errors.matrix[0]
        self.rest = np.concatenate([errors.bias_T[0] / FIELD_T, [DIP], np.zeros(6)])

    def bias_T(self) -> FloatArray:
        """Return the bias (3,) of the magnetometer where the sum of squares is least, tesla."""
        for _ in range(STEPS):
            jacobian, residual = self._linearised()
            step = splu((jacobian.T @ jacobian).tocsc()).solve(-(jacobian.T @ residual))
            turns, rest = np.split(step, [3 * len(self.time_s)])
            self.attitude = self.attitude * Rotation.from_rotvec(turns.reshape(-1, 3))
            self.matrix = self.matrix + rest[:9].reshape(3, 3)
            self.rest = self.rest + rest[9:]
        return FIELD_T * self.rest[:3]

    def _linearised(self) -> tuple[sparse.csr_matrix, FloatArray]:
        """Return Jacobian and residuals by the turns of all samples, matrix, bias, dip and both other biases."""
        bias, dip, of_force, of_rate = np.split(self.rest, [3, 4, 7])
        count, noise = len(self.time_s), 1e-9 / FIELD_T
        world = np.array([0.0, np.cos(dip[0]), -np.sin(dip[0])])
        by_dip = self.attitude.inv().apply([0.0, -np.sin(dip[0]), -np.cos(dip[0])])
        field, up = self.attitude.inv().apply(world), self.attitude.inv().apply([0.0, 0.0, GRAVITY])
        rest = np.zeros((3, count, 3, 19))
        rest[0, :, :, :9] = np.einsum("ik,nj->nikj", np.eye(3), field).reshape(count, 3, 9)
        rest[0, :, :, 9:12] = np.eye(3)
        rest[0, :, :, 12] = by_dip @ self.matrix.T
        rest[0] /= noise
        rest[1, :, :, 13:16] = np.eye(3) / ACCELEROMETER
        rest[2, :-1, :, 16:] = self.interval_s[:, :, None] * np.eye(3) / self.turn_noise
        measured = Rotation.from_rotvec(self.turns - of_rate * self.interval_s)
        turned = self.attitude[:-1].inv() * self.attitude[1:]
        residuals = (
            (field @ self.matrix.T + bias - self.readings) / noise,
            (up + of_force - self.force) / ACCELEROMETER,
            (measured.inv() * turned).as_rotvec() / self.turn_noise,
        )
        after = sparse.eye_array(3 * count, format="csr")[3:]
        before = sparse.block_diag(list(turned.inv().as_matrix()), format="csr")
        none = sparse.csr_array((3 * count - 3, 3))
        by_turns = (
            sparse.block_diag(list(self.matrix @ _skew(field) / noise), format="csr"),
            sparse.block_diag(list(_skew(up) / ACCELEROMETER), format="csr"),
            (after - sparse.hstack([before, none])) / self.turn_noise,
        )
        by_rest = (rest[0].reshape(-1, 19), rest[1].reshape(-1, 19), rest[2, :-1].reshape(-1, 19))
        blocks = [
            sparse.hstack([turns, sparse.csr_array(dense)]) for turns, dense in zip(by_turns, by_rest, strict=True)
        ]
        return sparse.vstack(blocks).tocsr(), np.concatenate([each.ravel() for each in residuals])


def _skew(vectors: FloatArray) -> FloatArray:
    """Return the matrices (N, 3, 3) of the cross products of vectors (N, 3) with others."""
    return np.cross(vectors[:, None], np.eye(3)).swapaxes(1, 2)


@click.command(help=__doc__)
@click.option("--runs", default=20, show_default=True, help="Recordings of each case.")
@click.option("--seed", default=1, show_default=True, help="Of the first of them.")
def main(runs: int, seed: int) -> None:
    """Print the figures, and keep them."""
    rows = []
    for case in (Case(tilt_deg=tilt, has_scalar=False) for tilt in (5.0, 30.0)):
        found = [answers(case, seed + number) for number in track(range(runs), case.name)]
        for name in found[0]:
            away_nT, times_s = zip(*(each[name] for each in found), strict=True)
            size = float(np.sqrt(np.mean(np.square(away_nT))))
            rows.append(Row(case.name, f"RMSE of the biases by {name}, nT", [size]))
            rows.append(Row(case.name, f"time of the processor of {name}, s", times_s))
    show("Other methods and this package", f"gyroscope_rivals.py --runs {runs}", "gyroscope_rivals.csv", rows)


if __name__ == "__main__":
    main()
