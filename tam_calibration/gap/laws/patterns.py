"""What laws do to the residual: the columns of a pattern at each place."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.harmonics import fields
from tam_calibration.effects.covariates import lagged
from tam_calibration.effects.curves import play
from tam_calibration.gap.laws.decisions import PLAYS, RATE_LAGS
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray

AXES = "xyz"


@dataclass(frozen=True, eq=False)
class Pattern:
    """A law at a place.

    Parameters
    ----------
    law : str
        Of ``signature`` in the gap's JSON.
    sensors : tuple
        Numbers from 1, or "scalar".
    axes : tuple of str
        The axes that are disturbed.
    rows : (r,) array
        Rows that it shifts.
    features : (N, r, p) array
        Shift of each row by a coefficient of one, in units of the field or of the row.
    """

    law: str
    sensors: tuple[int | str, ...]
    axes: tuple[str, ...]
    rows: NDArray[np.intp]
    features: FloatArray
    follows: str | None = field(default=None)

    def columns(self, residual: Residual) -> FloatArray:
        """Return the columns (N, C, p) of the whitened residual, of unit mean square in a sample all together."""
        columns, size = self.scaled(residual)
        return columns / size

    def scaled(self, residual: Residual) -> tuple[FloatArray, float]:
        """Return the columns (N, C, p) as they are, and their root mean square size."""
        columns: FloatArray = residual.response[:, :, self.rows] @ self.features
        size = float(np.sqrt(np.mean(np.sum(columns**2, axis=(1, 2))) / columns.shape[2]))
        return columns, size if size > 0 else 1.0

    def times(self, course: FloatArray, follows: str | None = None) -> "Pattern":
        """Return the pattern with features times courses (N, c)."""
        features = (self.features[:, :, :, None] * course[:, None, None, :]).reshape(*self.features.shape[:2], -1)
        return Pattern(self.law, self.sensors, self.axes, self.rows, features, follows)


def sensor_rows(sensor: int) -> NDArray[np.intp]:
    """Return the rows of a sensor, counted from 1."""
    return 3 * (sensor - 1) + np.arange(3)


def _each(values: FloatArray, row_count: int) -> FloatArray:
    """Return features (N, r, r f) in which each row has coefficients of its own for values (N, f)."""
    eye = np.eye(row_count)
    return np.asarray(np.einsum("rs,nf->nrsf", eye, values).reshape(len(values), row_count, -1))


def in_sensor(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield offset, gain and rate laws of one sensor, of all axes and of one."""
    rows = sensor_rows(sensor)
    one = np.ones((residual.count, 1))
    sensed, rate = residual.sensed[:, rows], residual.sensed_rate[:, rows]
    yield Pattern("offset", (sensor,), tuple(AXES), rows, _each(one, 3))
    for axis in range(3):
        yield Pattern("offset", (sensor,), (AXES[axis],), rows[axis : axis + 1], one[:, None])
    yield Pattern("gain", (sensor,), tuple(AXES), rows, _each(residual.field, 3))
    yield Pattern("gain", (sensor,), tuple(AXES), rows, sensed[:, :, None])
    yield Pattern("gain", (sensor,), tuple(AXES), rows, np.cross(np.eye(3)[None], sensed[:, None]).transpose(0, 2, 1))
    for axis in range(3):
        yield Pattern("gain", (sensor,), (AXES[axis],), rows[axis : axis + 1], sensed[:, None, axis : axis + 1])
        yield Pattern("gain", (sensor,), (AXES[axis],), rows[axis : axis + 1], residual.field[:, None])
    yield Pattern("rate", (sensor,), tuple(AXES), rows, rate[:, :, None])
    for axis in range(3):
        yield Pattern("rate", (sensor,), (AXES[axis],), rows[axis : axis + 1], rate[:, None, axis : axis + 1])


def switched_gains(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield gains of a sensor that change together with its offsets, of all axes and of one."""
    rows = sensor_rows(sensor)
    both = np.column_stack([residual.field, np.ones(residual.count)])
    yield Pattern("gain", (sensor,), tuple(AXES), rows, _each(both, 3))
    for axis in range(3):
        yield Pattern("gain", (sensor,), (AXES[axis],), rows[axis : axis + 1], both[:, None])


def rates_of(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield laws of a rate with a free matrix, which are constant."""
    rows = sensor_rows(sensor)
    for rates in (residual.rate, _with_lags(residual)):
        yield Pattern("rate", (sensor,), tuple(AXES), rows, _each(rates, 3))
        for axis in range(3):
            yield Pattern("rate", (sensor,), (AXES[axis],), rows[axis : axis + 1], rates[:, None])


def _with_lags(residual: Residual) -> FloatArray:
    """Return the rate of the field as it is and after first-order lags (N, 12)."""
    step_s = float(np.median(np.diff(residual.time_s)))
    lags = [lagged(residual.rate, residual.time_s, lag * step_s) for lag in RATE_LAGS]
    return np.column_stack([residual.rate, *lags])


def in_scalar(residual: Residual) -> Iterator[Pattern]:
    """Yield laws of the scalar."""
    row = np.array([3 * residual.sensor_count])
    yield Pattern("offset", ("scalar",), (), row, np.ones((residual.count, 1, 1)))
    yield Pattern("gain", ("scalar",), (), row, residual.field[:, None])


def everywhere(residual: Residual) -> Iterator[Pattern]:
    """Yield laws of all sensors that stay or follow a channel: the same in all, and of each its own."""
    count = residual.sensor_count
    every, rows = tuple(range(1, count + 1)), np.arange(3 * count)
    yield Pattern("rate", every, tuple(AXES), rows, residual.sensed_rate[:, :, None])
    matrix = field_matrix(residual)
    for rates in (residual.rate, _with_lags(residual)):
        common = np.einsum("rj,nk->nrjk", matrix, rates).reshape(residual.count, len(rows), -1)
        yield Pattern("rate", every, tuple(AXES), rows, common)
    yield Pattern("rate", every, tuple(AXES), rows, _each(residual.rate, len(rows)))


def offsets_everywhere(residual: Residual) -> Pattern:
    """Return an offset of each axis of all sensors."""
    count = residual.sensor_count
    return Pattern(
        "offset",
        tuple(range(1, count + 1)),
        tuple(AXES),
        np.arange(3 * count),
        _each(np.ones((residual.count, 1)), 3 * count),
    )


def field_matrix(residual: Residual) -> FloatArray:
    """Return the matrix (3K, 3) from the field to what the axes sense."""
    return np.linalg.lstsq(residual.field, residual.sensed, rcond=None)[0].T


def own_fields(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield functions of each axis' own reading: curves, loops and ends."""
    rows = sensor_rows(sensor)
    for axis, row in enumerate(rows):
        yield Pattern("own_field", (sensor,), (AXES[axis],), rows[axis : axis + 1], _beyond(residual, row)[:, None])
    parts = [_own_functions(residual.sensed[:, row]) for row in rows]
    for axis in range(3):
        yield Pattern("own_field", (sensor,), (AXES[axis],), rows[axis : axis + 1], parts[axis][:, None])
    width = parts[0].shape[1]
    features = np.zeros((residual.count, 3, 3 * width))
    for axis in range(3):
        features[:, axis, axis * width : (axis + 1) * width] = parts[axis]
    yield Pattern("own_field", (sensor,), tuple(AXES), rows, features)


def _beyond(residual: Residual, row: int) -> FloatArray:
    """Return by how much the field along an axis exceeds the extreme readings of that axis (N, 2)."""
    field, reading = residual.sensed[:, row], residual.own[:, row]
    return np.column_stack([np.maximum(field - reading.max(), 0), np.minimum(field - reading.min(), 0)])


def _own_functions(reading: FloatArray) -> FloatArray:
    """Return curves and loops of a reading (N,), standardised (N, F)."""
    half = max((reading.max() - reading.min()) / 2, 1e-12)
    x = (reading - (reading.max() + reading.min()) / 2) / half
    loops = play(x[:, None], np.array(PLAYS))[:, 0]
    columns = np.column_stack([x**2, x**3, x**4, x**5, loops, loops**3])
    columns = columns - columns.mean(axis=0)
    size = columns.std(axis=0)
    return np.asarray(columns / np.where(size > 0, size, np.inf))


def _polynomials(vectors: FloatArray, degrees: tuple[int, ...]) -> FloatArray:
    """Return the monomials (N, F) of some degrees in the components of vectors (N, 3), about their means."""
    chosen = [index for degree in degrees for index in combinations_with_replacement(range(3), degree)]
    columns = np.column_stack([np.prod(vectors[:, list(one)], axis=1) for one in chosen])
    return np.asarray(columns - columns.mean(axis=0))


def attitudes(residual: Residual, sensor: int | str) -> Iterator[Pattern]:
    """Yield functions of the direction of the field in a sensor, of that of gravity, and of the attitude."""
    rows = np.array([3 * residual.sensor_count]) if sensor == "scalar" else sensor_rows(int(sensor))
    axes = () if sensor == "scalar" else tuple(AXES)
    by_field = _polynomials(residual.field, (2, 3))
    functions: list[tuple[str, FloatArray]] = [("attitude", by_field)]
    if sensor == "scalar":
        functions.append(("attitude", _polynomials(residual.field, (2, 3, 4, 5))))
        functions.append(("rate", residual.rate))
    if residual.up is not None and residual.rotation is not None and residual.turning is not None:
        up, turning = residual.up, residual.turning
        functions.append(("attitude", up - up.mean(axis=0)))
        functions.append(("attitude", _polynomials(up, (1, 2))))
        functions.append(("attitude", residual.rotation.reshape(-1, 9) - residual.rotation.reshape(-1, 9).mean(axis=0)))
        functions.append(("offset", _polynomials(turning, (2,))))
        if sensor == "scalar":
            along = (turning * residual.field).sum(axis=1)
            functions.append(("rate", np.column_stack([along, np.abs(along)])))
        else:
            bent = (up[:, :, None] * residual.field[:, None]).reshape(len(up), 9)
            functions.append(("attitude", bent))
    else:
        functions.append(("offset", _polynomials(residual.rate, (2,))))
    for law, values in functions:
        follows = "attitude" if law == "attitude" else "motion"
        yield Pattern(law, (sensor,), axes, rows, _each(values, len(rows)), follows)
        if sensor != "scalar":
            for axis in range(3):
                yield Pattern(law, (sensor,), (AXES[axis],), rows[axis : axis + 1], values[:, None], follows)


def bent_everywhere(residual: Residual) -> Iterator[Pattern]:
    """Yield rotations of every sensor that follow gravity, each its own."""
    if residual.up is None:
        return
    count = residual.sensor_count
    bent = (residual.up[:, :, None] * residual.field[:, None]).reshape(residual.count, 9)
    every = tuple(range(1, count + 1))
    yield Pattern("attitude", every, tuple(AXES), np.arange(3 * count), _each(bent, 3 * count), "attitude")


def sharp_attitudes(residual: Residual, sensor: int, axes: tuple[str, ...]) -> Pattern:
    """Return any function of the direction of the field up to the fifth degree, in the axes of a sensor."""
    rows = sensor_rows(sensor)[[AXES.index(axis) for axis in axes]]
    values = _polynomials(residual.field, (2, 3, 4, 5))
    return Pattern("attitude", (sensor,), axes, rows, _each(values, len(rows)), "attitude")


def gradients(residual: Residual, positions_m: FloatArray) -> Iterator[Pattern]:
    """Yield a field in the world that is not uniform: harmonic potentials of degree 2, and of 2 and 3."""
    if residual.rotation is None or not positions_m.any():
        return
    count = residual.sensor_count
    matrix = field_matrix(residual).reshape(count, 3, 3)
    rotation = residual.rotation
    parts = []
    for degree in (2, 3):
        of_sensors = []
        for position, own in zip(positions_m, matrix, strict=True):
            world = fields(degree, (rotation @ position).T)
            of_sensors.append(np.einsum("ab,nkb,pkn->nap", own, rotation, world, optimize=True))
        parts.append(np.concatenate(of_sensors, axis=1))
        parts[-1] = parts[-1] / np.sqrt(np.mean(parts[-1] ** 2))
    every = tuple(range(1, count + 1))
    for features in (parts[0], np.concatenate(parts, axis=2)):
        yield Pattern("attitude", every, tuple(AXES), np.arange(3 * count), features, "attitude")
