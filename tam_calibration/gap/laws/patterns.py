"""What laws do to the residual: the columns of a pattern at each place."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations_with_replacement

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.harmonics import fields
from tam_calibration.core.least_squares import ROUNDING
from tam_calibration.effects.recursions import lagged, play
from tam_calibration.gap.laws.evidence import Bins, Fit, Normal, Products, Sums, course
from tam_calibration.gap.laws.law import SCALAR, Place
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
    shifts : (N, r, f), (N, 1, f) or (N, r, p) array
        What a coefficient of one shifts each row by, in units of the field or of the row: f values of each row, which
        has coefficients of its own, p = r f, or the same f values of all; or what each of p coefficients does to all
        rows.
    follows : str, optional
        A recorded channel, "motion", "attitude", or a frequency.
    drive : (N, c) array, optional
        What the shifts are multiplied by.
    matrix : (r, 3) array, optional
        From the field to the rows, where each component of the field at all sensors takes the place of a row.
    is_apart : bool
        Whether each row has coefficients of its own.
    """

    law: str
    sensors: tuple[int | str, ...]
    axes: tuple[str, ...]
    rows: NDArray[np.intp]
    shifts: FloatArray
    follows: str | None = None
    drive: FloatArray | None = None
    matrix: FloatArray | None = None
    is_apart: bool = True

    @property
    def by_row(self) -> FloatArray:
        """(N, r, f) or (N, r, p) shifts of each row, or of each component of the field."""
        rows = len(self.rows) if self.matrix is None else self.matrix.shape[1]
        return np.broadcast_to(self.shifts, (len(self.shifts), rows, self.shifts.shape[2]))

    @property
    def features(self) -> FloatArray:
        """(N, r, p) shift of each row by each coefficient."""
        if not self.is_apart:
            return self.shifts
        matrix = np.eye(len(self.rows)) if self.matrix is None else self.matrix
        return np.asarray(np.einsum("rs,nsf->nrsf", matrix, self.by_row).reshape(len(self.shifts), len(matrix), -1))

    @property
    def width(self) -> int:
        """Number of coefficients p."""
        _, rows, each = self.by_row.shape
        return int(rows * each if self.is_apart else each)

    def parts(self) -> Iterator[tuple["Pattern", NDArray[np.intp]]]:
        """Yield it, and where the axes of a sensor have coefficients of their own each axis, with their columns."""
        columns = np.arange(self.width)
        yield self, columns
        if len(self.rows) == len(AXES) and self.is_apart:
            for axis, own in enumerate(np.split(columns, len(AXES))):
                shifts = self.by_row[:, axis : axis + 1]
                yield replace(self, axes=(AXES[axis],), rows=self.rows[[axis]], shifts=shifts), own

    def columns(self, residual: Residual) -> FloatArray:
        """Return the columns (N, C, p) of the whitened residual, of unit mean square in a sample all together."""
        return np.asarray(residual.response[:, :, self.rows] @ (self.features / self.size(residual)))

    def of_rows(self, residual: Residual) -> Products:
        """Return the products of the responses to shifts of its rows, or of the field."""
        if self.matrix is not None:
            return residual.of_field()
        return residual.of_rows(self.rows)

    def size(self, residual: Residual) -> float:
        """Return the root mean square of the columns of its features; infinite where the channels do not see them."""
        information = self.of_rows(residual).information
        shifts = self.by_row
        most = float(np.trace(information, axis1=1, axis2=2) @ np.sum(shifts**2, axis=(1, 2)))
        if self.is_apart:
            square = float(np.einsum("nrr,nrf->", information, shifts**2))
        else:
            square = float(np.sum(shifts * (information @ shifts)))
        return float(np.sqrt(square / (residual.count * self.width))) if square > ROUNDING * most else np.inf

    def normal(self, residual: Residual) -> Normal:
        """Return the normal equations of constant coefficients."""
        return Normal.of(self.by_row, self.of_rows(residual), self.is_apart)

    def sums(self, residual: Residual, bins: Bins) -> Sums:
        """Return the sums of the columns in bins."""
        return Sums.of(self.by_row / self.size(residual), self.of_rows(residual), bins, self.is_apart)

    def times(self, course: FloatArray, follows: str | None = None) -> "Pattern":
        """Return the pattern with shifts times courses (N, c)."""
        beside = np.expand_dims(course, tuple(range(1, self.shifts.ndim)))
        shifts = (self.shifts[..., None] * beside).reshape(*self.shifts.shape[:-1], -1)
        return replace(self, shifts=shifts, follows=follows, drive=course)


def sensor_rows(sensor: int) -> NDArray[np.intp]:
    """Return the rows of a sensor, counted from 1."""
    return 3 * (sensor - 1) + np.arange(3)


def _at(
    law: str, residual: Residual, place: Place, shifts: FloatArray, follows: str | None = None, is_apart: bool = True
) -> Pattern:
    """Return a pattern of all axes of sensors, or of the scalar, with shifts (N, f) of each row or as the class has."""
    shifts = shifts[:, None] if shifts.ndim == 2 else shifts
    if place == SCALAR:
        return Pattern(law, place, (), np.array([3 * residual.sensor_count]), shifts, follows)
    rows = np.concatenate([sensor_rows(int(one)) for one in place])
    return Pattern(law, place, tuple(AXES), rows, shifts, follows, is_apart=is_apart)


def _every(residual: Residual) -> Place:
    """Return the place of all sensors."""
    return tuple(range(1, residual.sensor_count + 1))


def of_axis(law: str, sensor: int, axis: int, values: FloatArray) -> Pattern:
    """Return a pattern of one axis of a sensor with shifts (N, f)."""
    return Pattern(law, (sensor,), (AXES[axis],), sensor_rows(sensor)[[axis]], values[:, None])


def _scaling(law: str, residual: Residual, sensor: int, values: FloatArray) -> Iterator[Pattern]:
    """Yield patterns that are multiples of values of the axes (N, 3): of all axes with one coefficient, and of one."""
    yield _at(law, residual, (sensor,), values[:, sensor_rows(sensor), None], is_apart=False)
    for axis, row in enumerate(sensor_rows(sensor)):
        yield of_axis(law, sensor, axis, values[:, row, None])


def in_sensor(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield offset, gain and rate laws of one sensor; of one axis alone where it is no part of those of all axes."""
    sensed = residual.sensed[:, sensor_rows(sensor)]
    turned = np.cross(np.eye(3)[None], sensed[:, None]).transpose(0, 2, 1)
    yield _at("offset", residual, (sensor,), np.ones((residual.count, 1)))
    yield _at("gain", residual, (sensor,), residual.field)
    yield from _scaling("gain", residual, sensor, residual.sensed)
    yield _at("gain", residual, (sensor,), turned, is_apart=False)
    yield from _scaling("rate", residual, sensor, residual.sensed_rate)


def in_every_sensor(residual: Residual, law: "Candidate") -> Pattern | None:
    """Return a law with its course in all sensors, each with coefficients of its own; None for one of a common field.

    Parameters
    ----------
    residual : Residual
    law : Candidate
        Of an axis, a sensor or several.
    """
    pattern, drive = law.pattern, law.drive(residual)
    if pattern.law == "own_field":
        own = functions_of_readings(residual, range(3 * residual.sensor_count))
        return _at(pattern.law, residual, _every(residual), own * drive[:, None, :1], pattern.follows)
    steady = {"offset": np.ones((residual.count, 1)), "gain": residual.field, "rate": residual.rate}
    of_row = pattern.shifts[:, 0]
    is_narrow = not pattern.is_apart or of_row.shape[1] == (1 if pattern.drive is None else drive.shape[1])
    if pattern.matrix is not None or (is_narrow and pattern.law not in steady):
        return None
    if not is_narrow and pattern.drive is not None:
        return _at(pattern.law, residual, _every(residual), of_row, pattern.follows)
    values = steady[pattern.law] if is_narrow else of_row
    return _at(pattern.law, residual, _every(residual), values).times(drive, pattern.follows)


def functions_of_readings(residual: Residual, rows: Sequence[int]) -> FloatArray:
    """Return functions (N, r, F) of what axes sense, without those that offsets and gains are."""
    return np.stack([_curves_and_loops(residual.sensed[:, row]) for row in rows], axis=1)


def switched_gains(residual: Residual, sensor: int) -> list[Pattern]:
    """Return gains of a sensor that change together with its offsets, of all axes and of one."""
    both = _at("gain", residual, (sensor,), np.column_stack([residual.field, np.ones(residual.count)]))
    return [part for part, _ in both.parts()]


def of_motion(residual: Residual, place: int | str) -> Iterator[Pattern]:
    """Yield laws of a place that go with the motion: its own reading, rates with a free matrix, directions."""
    if place != "scalar":
        yield from _own_fields(residual, int(place))
        yield from (_at("rate", residual, (place,), rates) for rates in (residual.rate, _with_lags(residual)))
        yield from _of_speed(residual, int(place))
    yield from _attitudes(residual, place)


def _of_speed(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield what goes with a rate times its size: that of turning, as drag does, or that of an axis' own field."""
    drag = np.linalg.norm(residual.turning, axis=1, keepdims=True) * residual.turning
    yield _at("rate", residual, (sensor,), _bent(drag, residual.field), "motion")
    for axis, row in enumerate(sensor_rows(sensor)):
        own = residual.sensed_rate[:, row]
        pattern = of_axis("rate", sensor, axis, np.column_stack([own, own * np.abs(own)]))
        yield replace(pattern, follows="motion")


def _with_lags(residual: Residual) -> FloatArray:
    """Return the rate of the field as it is and after first-order lags (N, 12)."""
    step_s = float(np.median(np.diff(residual.time_s)))
    lags = [lagged(residual.rate, residual.time_s, lag * step_s) for lag in (1.0, 4.0, 16.0)]
    return np.column_stack([residual.rate, *lags])


def in_scalar(residual: Residual) -> Iterator[Pattern]:
    """Yield laws of the scalar."""
    yield _at("offset", residual, SCALAR, np.ones((residual.count, 1)))
    yield _at("attitude", residual, SCALAR, residual.field)


def everywhere(residual: Residual) -> Iterator[Pattern]:
    """Yield laws of all sensors: rates, the same in all and of each its own, and a field that is not uniform."""
    yield from gradients(residual)
    every = _every(residual)
    yield _at("rate", residual, every, residual.sensed_rate[:, :, None], is_apart=False)
    for rates in (residual.rate, _with_lags(residual)):
        yield replace(_at("rate", residual, every, rates), matrix=residual.matrix)
    yield _at("rate", residual, every, residual.rate)


def offsets_everywhere(residual: Residual) -> Pattern:
    """Return an offset of each axis of all sensors."""
    return _at("offset", residual, _every(residual), np.ones((residual.count, 1)))


def _own_fields(residual: Residual, sensor: int) -> Iterator[Pattern]:
    """Yield functions of each axis' own reading: curves, loops and ends."""
    rows = sensor_rows(sensor)
    for axis, row in enumerate(rows):
        yield of_axis("own_field", sensor, axis, _beyond(residual, row))
    yield _at("own_field", residual, (sensor,), functions_of_readings(residual, rows.tolist()))


def _beyond(residual: Residual, row: int) -> FloatArray:
    """Return by how much the field along an axis exceeds the extreme readings of that axis (N, 2)."""
    field, reading = residual.sensed[:, row], residual.own[:, row]
    return np.column_stack([np.maximum(field - reading.max(), 0), np.minimum(field - reading.min(), 0)])


def _curves_and_loops(reading: FloatArray) -> FloatArray:
    """Return curves and loops (N, F) of what an axis senses, standardised."""
    half = max((reading.max() - reading.min()) / 2, 1e-12)
    x = (reading - (reading.max() + reading.min()) / 2) / half
    # Half-widths of loops, as parts of the half range: narrow to wide.
    loops = play(x[:, None], np.array([0.03, 0.08, 0.16, 0.26, 0.4, 0.65]))[:, 0]
    columns = np.column_stack([x**2, x**3, x**4, x**5, loops, loops**3])
    columns = columns - columns.mean(axis=0)
    size = columns.std(axis=0)
    return np.asarray(columns / np.where(size > 0, size, np.inf))


def _polynomials(vectors: FloatArray, degrees: tuple[int, ...]) -> FloatArray:
    """Return the monomials (N, F) of some degrees in the components of vectors (N, 3), about their means."""
    chosen = [index for degree in degrees for index in combinations_with_replacement(range(3), degree)]
    columns = np.column_stack([np.prod(vectors[:, list(one)], axis=1) for one in chosen])
    return np.asarray(columns - columns.mean(axis=0))


def _attitudes(residual: Residual, sensor: int | str) -> Iterator[Pattern]:
    """Yield functions of the direction of the field in a sensor, of that of gravity, and of the attitude."""
    functions: list[tuple[str, FloatArray]] = [("attitude", _polynomials(residual.field, (2, 3)))]
    if sensor == "scalar":
        functions.append(("attitude", _polynomials(residual.field, (2, 3, 4, 5))))
        functions.append(("rate", residual.rate))
    functions.append(("offset", _polynomials(residual.turning, (2,))))
    if residual.up is not None:
        up, axes = residual.up, residual.pose
        functions += [("attitude", up - up.mean(axis=0)), ("attitude", _polynomials(up, (1, 2)))]
        functions.append(("attitude", axes - axes.mean(axis=0)))
        if sensor == "scalar":
            along = (residual.turning * residual.field).sum(axis=1)
            functions.append(("rate", np.column_stack([along, np.abs(along)])))
        else:
            functions.append(("attitude", _bent(up, residual.field)))
    for law, values in functions:
        follows = {"attitude": "attitude", "offset": "motion"}.get(law)
        yield _at(law, residual, (sensor,), values, follows)


def _bent(by: FloatArray, field: FloatArray) -> FloatArray:
    """Return the products (N, 9) of the components of two vectors (N, 3)."""
    return (by[:, :, None] * field[:, None]).reshape(len(by), 9)


def bent_everywhere(residual: Residual) -> Iterator[Pattern]:
    """Yield rotations of every sensor that follow gravity, each its own."""
    if residual.up is not None:
        bent = _bent(residual.up, residual.field)
        yield _at("attitude", residual, _every(residual), bent, "attitude")


def gradients(residual: Residual) -> Iterator[Pattern]:
    """Yield a field in the world that is not uniform: harmonic potentials of degree 2, and of 2 and 3."""
    positions_m = np.asarray(residual.model.array.positions_m)
    if residual.rotation is None or not positions_m.any():
        return
    rotation, matrices = residual.rotation, residual.matrix.reshape(-1, 3, 3)

    def of_degree(degree: int) -> FloatArray:
        of_sensors = []
        for position, own in zip(positions_m, matrices, strict=True):
            world = fields(degree, (rotation @ position).T)
            of_sensors.append(np.einsum("ab,nkb,pkn->nap", own, rotation, world, optimize=True))
        part = np.concatenate(of_sensors, axis=1)
        return np.asarray(part / np.sqrt(np.mean(part**2)))

    second, third = of_degree(2), of_degree(3)
    for features in (second, np.concatenate([second, third], axis=2)):
        yield _at("attitude", residual, _every(residual), features, "attitude", is_apart=False)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A law with its course, its evidence, and how it is fitted.

    Parameters
    ----------
    pattern : Pattern
    course : str
    evidence : float
        Log marginal likelihood over that of no law, less the log of the number of ones tried.
    bins : Bins, optional
        Of a course in time or over a reading.
    length : float
        Correlation length of the course.
    steps : tuple of int
        Bins at which steps are.
    """

    pattern: Pattern
    course: str
    evidence: float
    bins: Bins | None = None
    length: float = 0.0
    variance: float = 1.0
    steps: tuple[int, ...] = ()
    begins_on: bool | None = None

    def drive(self, residual: Residual) -> FloatArray:
        """Return what its size is proportional to (N, c), as far as the motion does not say it."""
        if self.pattern.drive is not None:
            return self.pattern.drive
        coefficients = self.coefficients(self.fitted(residual).mean, residual.count)
        if self.bins is None:
            return np.ones((residual.count, 1))
        course = np.linalg.svd(coefficients, full_matrices=False)[0][:, :1]
        return np.asarray(course / np.sqrt(np.mean(course**2)))

    def features(self, residual: Residual) -> FloatArray:
        """Return the features (N, r, p) of its coefficients, that of the pattern where these are constant."""
        features = self.pattern.features / self.pattern.size(residual)
        if not self.steps:
            return features
        passed = self.passed(residual.count)
        if self.begins_on is not None:
            return np.asarray(features * ((passed + self.begins_on) % 2)[:, None, None])
        return np.concatenate([features * (passed > step)[:, None, None] for step in range(len(self.steps))], axis=2)

    def passed(self, count: int) -> NDArray[np.intp]:
        """Return how many of the steps each sample (N,) has passed."""
        assert self.bins is not None
        return np.searchsorted(self.steps, self.bins.spread(np.arange(len(self.bins.place)), count), side="right")

    def fitted(self, residual: Residual, with_errors: bool = False) -> Fit:
        """Return the fit to a residual."""
        if self.steps:
            return Normal.of(self.features(residual), residual.of_rows(self.pattern.rows)).fit()
        if self.bins is None:
            pattern = self.pattern
            shifts = pattern.by_row / pattern.size(residual)
            return Normal.of(shifts, pattern.of_rows(residual), pattern.is_apart).fit()
        return course(self.pattern.sums(residual, self.bins), self.length, np.array([self.variance]), with_errors)

    def signal(self, residual: Residual, training: Residual) -> FloatArray:
        """Return what the law, fitted to one residual of a recording, adds to the channels (N, C) of any."""
        coefficients = self.coefficients(self.fitted(training).mean, residual.count)
        return np.asarray((self.pattern.columns(residual) @ coefficients[:, :, None])[:, :, 0])

    def coefficients(self, fitted: FloatArray, count: int) -> FloatArray:
        """Return the coefficients (N, p) of the pattern at every sample, from those that were fitted (B, p)."""
        if self.bins is None:
            return np.broadcast_to(fitted, (count, fitted.shape[1]))
        if not self.steps:
            return self.bins.spread(fitted, count)
        passed = self.passed(count)
        if self.begins_on is not None:
            return np.asarray(((passed + self.begins_on) % 2)[:, None] * fitted)
        changes = fitted.reshape(len(self.steps), -1)
        return np.vstack([0 * changes[:1], np.cumsum(changes, axis=0)])[passed]
