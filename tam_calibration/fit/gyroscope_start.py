"""Where the fit of a gyroscope begins: its unit, how it is mounted and how late it is, from the field that it turns.

Over a short time the direction u of the field changes by u × ψ, with ψ = M φ, where φ is the integral of the angular
velocity less that of a bias. The sum of squares is quadratic in M and the bias; its delay is tried, and M is a multiple
of a rotation. A multiple of a mirrored rotation that fits better shows axes that are left-handed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.gyroscope_path import GyroscopePath
from tam_calibration.model.sensor_errors import ORIENTATIONS
from tam_calibration.model.units import FloatArray, from_degrees

_TURN = 0.05
"""Turn of the field over which changes are compared, radians: far above the noise, and nearly linear."""

_MOST = 4000
"""Changes that are compared."""

_DELAYS_S = np.linspace(-1.0, 1.0, 81)
"""Delays that are tried, seconds."""

_TRIED, _STEPS = 4, 12
"""Rotations by right angles, the best of all 24, from which the fit begins, and its steps."""

_LEAST_EXPLAINED = 0.5
"""Part of the changes of the field that the angular velocity must explain."""

_UNIT_ERROR = 1.5
"""Factor by which the size of the readings may miss that of their unit; degrees are 57 times as many as radians."""

_MUCH_BETTER = 0.5
"""Sum of squares of a mirrored rotation over that of a rotation from which axes are left-handed."""

_RIDGE = 1e-6
"""Part of the information that is added: it decides where the changes tell nothing."""

UNITS = {"rad/s": 1.0, "°/s": from_degrees(1.0)}
"""Units that are recognised by the size of the readings, in rad/s."""


@dataclass(frozen=True, eq=False)
class Match:
    """How a gyroscope goes with the field.

    Parameters
    ----------
    unit : str
        Of its readings, one of ``UNITS``.
    mount : (3, 3) array
        Rotation from its frame to that of the sensors.
    delay_s : float
        How much later than it was measured its reading is stamped.
    reason : str
        Why it cannot be used; empty where it can.
    """

    unit: str
    mount: FloatArray
    delay_s: float
    reason: str = ""


def matched(along: FloatArray, path: GyroscopePath) -> Match:
    """Return how angular velocities go with the directions of the field.

    Parameters
    ----------
    along : (N, 3) array
        Directions of the field in the frame of the sensors, unit vectors.
    path : GyroscopePath
        The angular velocities.
    """
    before, after, turns = _changes(along, path)
    tried = [_Quadratic.of(before, after, turns(delay_s), float(delay_s)) for delay_s in _DELAYS_S]
    best = min(tried, key=lambda quadratic: quadratic.least)
    (cost, scale, mount), (mirrored, _, _) = best.rotation(1.0), best.rotation(-1.0)
    unit = min(UNITS, key=lambda name: abs(np.log(scale / UNITS[name])))
    match = Match(unit, mount, best.delay_s)
    if min(cost, mirrored) > (1 - _LEAST_EXPLAINED) * best.square:
        return replace(match, reason="the angular velocity does not go with the turns of the field")
    if mirrored < _MUCH_BETTER * cost:
        return replace(
            match, reason="the field turns as if the axes of the gyroscope or of the sensors were left-handed"
        )
    if not 1 / _UNIT_ERROR < scale / UNITS[unit] < _UNIT_ERROR:
        return replace(match, reason=f"the field turns {scale:.3g} times as far as the angular velocity in rad/s says")
    return match


def _changes(along: FloatArray, path: GyroscopePath) -> tuple[FloatArray, FloatArray, Callable[[float], FloatArray]]:
    """Return fields (n, 3) before and after some changes, and what returns the integrals (n, 4) of rates and 1."""
    count = len(along)
    steps = np.array([1, 2, 5, 10, 20, 50, 100, 200])
    steps = steps[steps <= max(count // 10, 1)]
    chords = [np.sqrt(np.mean(np.sum((along[step:] - along[:-step]) ** 2, axis=1))) for step in steps]
    step = int(steps[min(int(np.searchsorted(np.maximum.accumulate(chords), _TURN)), len(steps) - 1)])
    first = path.links[path.links < count - step]
    first = first[np.isin(first + step - 1, path.links)]
    first = first[:: len(first) // _MOST + 1]
    last = first + step

    def turns(delay_s: float) -> FloatArray:
        turned = path.integral(path.time_s[last] + delay_s) - path.integral(path.time_s[first] + delay_s)
        return np.column_stack([turned, path.time_s[last] - path.time_s[first]])

    return along[first], along[last], turns


@dataclass(frozen=True, eq=False)
class _Quadratic:
    """The sum of squares m·H m - 2 g·m + s over the rows m of M, the bias eliminated."""

    normal: FloatArray
    slope: FloatArray
    square: float
    delay_s: float

    @classmethod
    def of(cls, before: FloatArray, after: FloatArray, turns: FloatArray, delay_s: float) -> "_Quadratic":
        middle = (before + after) / 2
        by_turn = np.cross(middle[:, None], np.eye(3))  # (n, i, 3): the change by a turn about axis i
        columns = np.einsum("nix,nj->xnij", by_turn, turns).reshape(3 * len(turns), 3, 4)
        rates, bias = columns[:, :, :3].reshape(-1, 9), columns[:, :, 3]
        change = (after - before).T.ravel()
        basis, _ = np.linalg.qr(bias)
        rates, change = rates - basis @ (basis.T @ rates), change - basis @ (basis.T @ change)
        return cls(rates.T @ rates, rates.T @ change, float(change @ change), delay_s)

    @property
    def least(self) -> float:
        """The sum of squares of any M."""
        ridged = self.normal + _RIDGE * np.trace(self.normal) * np.eye(9)
        return self.square - float(self.slope @ np.linalg.solve(ridged, self.slope))

    def rotation(self, sign: float) -> tuple[float, float, FloatArray]:
        """Return the least sum of squares of a multiple of a rotation, or of a mirrored one, and scale and rotation."""
        from scipy.spatial.transform import Rotation

        found = []
        ridge = _RIDGE * float(np.trace(self.normal))
        starts = ORIENTATIONS.reshape(-1, 9)
        along = np.maximum(sign * starts @ self.slope, 0.0)
        size = np.einsum("ti,ij,tj->t", starts, self.normal, starts) + ridge
        for start in np.argsort(-(along**2) / size)[:_TRIED]:
            turn, scale = ORIENTATIONS[start], max(float(along[start] / size[start]), _RIDGE)
            for _ in range(_STEPS):
                matrix = sign * scale * turn
                away = self.slope - self.normal @ matrix.ravel()
                by_turn = [np.cross(axis, matrix, axisb=0, axisc=0).ravel() for axis in np.eye(3)]
                columns = np.column_stack([*by_turn, matrix.ravel()])
                normal = columns.T @ self.normal @ columns + ridge * scale**2 * np.eye(4)
                step = np.linalg.solve(normal, columns.T @ away)
                turn = Rotation.from_rotvec(step[:3] / max(1.0, float(norm(step[:3])))).as_matrix() @ turn
                scale *= float(np.exp(np.clip(step[3], -1, 1)))
            matrix = (sign * scale * turn).ravel()
            cost = self.square - 2 * float(self.slope @ matrix) + float(matrix @ self.normal @ matrix)
            # Of rotations that fit as well, the least one.
            found.append((cost + ridge * scale**2 * float(norm(turn - np.eye(3)) ** 2), cost, scale, turn))
        _, cost, scale, turn = min(found, key=lambda each: each[0])
        return cost, scale, turn
