"""Terms: regressors of an effect with their rows; places; and the whitened residuals of a model."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.normal_equations import ridged
from tam_calibration.effects.covariates import Covariates
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class WhitenedResiduals:
    """Whitened residuals of a model, for effects that are found otherwise than by regression.

    Parameters
    ----------
    recording : Recording
        As read.
    covariates : Covariates
        Field and channels at each sample.
    differential : (N, C) array
        Whitened residuals between the sensors, or against the field of the world, of unit variance under the model.
    directions : (3K, C) array
        Their derivatives by a shift of each row, 1/T.
    common_mode : (N,) array
        Whitened residual of the scalar against the length of the field; NaN where there is no reference.
    row_slope : (N, 3K + 1) array
        Derivative of the common mode by a shift of each row, 1/T.
    channel_count : (N,) array
        Number of whitened channels of each sample.
    is_counted : (N,) array of bool
        False where a sample is excluded, as an outlier or as saturated.
    """

    recording: Recording
    covariates: Covariates
    differential: FloatArray
    directions: FloatArray
    common_mode: FloatArray
    row_slope: FloatArray
    channel_count: FloatArray
    is_counted: NDArray[np.bool_]

    @cached_property
    def energy(self) -> FloatArray:
        """(N,) sums of the squares of each sample's whitened channels."""
        return np.asarray(np.sum(self.differential**2, axis=1) + np.nan_to_num(self.common_mode) ** 2)

    @cached_property
    def row_information(self) -> FloatArray:
        """(N, 3K + 1) information of a sample on a shift of one row alone, 1/T²."""
        of_rows = np.append(np.sum(self.directions**2, axis=1), 0.0)
        has_reference = np.isfinite(self.common_mode)
        return of_rows + has_reference[:, None] * self.row_slope**2

    @cached_property
    def row_shift_T(self) -> FloatArray:
        """(N, 3K + 1) the shift of one row alone that explains a sample best, tesla; 0 without information."""
        score = np.nan_to_num(self.common_mode)[:, None] * self.row_slope
        score[:, :-1] += self.differential @ self.directions.T
        information = self.row_information
        return np.divide(score, information, out=np.zeros_like(score), where=information > 0)

    def energy_without(self, shift_T: FloatArray) -> FloatArray:
        """Return the residual energy (N,) after subtracting shifts (N, 3K) from the readings, tesla."""
        common = self.common_mode - np.sum(self.row_slope[:, :-1] * shift_T, axis=1)
        return np.asarray(
            np.sum((self.differential - shift_T @ self.directions) ** 2, axis=1) + np.nan_to_num(common) ** 2
        )


@dataclass(frozen=True)
class Place:
    """Some axes of a sensor, or the scalar magnetometer, or all.

    Parameters
    ----------
    sensor : int
        Index of the sensor, or ``SCALAR`` or ``ALL``.
    axes : tuple of int
        Indices of its axes.
    rows : tuple of int
        The same as rows of a sample.
    """

    sensor: int
    axes: tuple[int, ...]
    rows: tuple[int, ...]

    def contribution_keys(self, is_whole: bool = True) -> tuple[tuple[int, int | None], ...]:
        """Return sensor and axis of each contribution: one without axis for a sensor as a whole, else one per axis."""
        if not self.axes or (is_whole and len(self.axes) == 3):
            return ((self.sensor, None),)
        return tuple((self.sensor, axis) for axis in self.axes)


def places(sensor_count: int) -> list[Place]:
    """Return the scalar, and of every sensor each axis, each pair of axes and all three."""
    found = [Place(SCALAR, (), (3 * sensor_count,))]
    for sensor in range(sensor_count):
        for count in (1, 2, 3):
            for axes in combinations(range(3), count):
                found.append(Place(sensor, axes, tuple(3 * sensor + axis for axis in axes)))
    return found


def everywhere(sensor_count: int) -> Place:
    """Return the place of an effect that is common to all sensors."""
    return Place(ALL, (), tuple(range(3 * sensor_count)))


def rows_of(part: Contribution, covariates: Covariates) -> list[int]:
    """Return the rows on which a contribution acts.

    Parameters
    ----------
    part : Contribution
        Its sensor and axis are used.
    covariates : Covariates
        Tell the number of sensors.
    """
    if part.sensor == SCALAR:
        return [covariates.scalar_row]
    sensors = range(covariates.sensor_count) if part.sensor == ALL else [part.sensor]
    axes = range(3) if part.axis is None else [part.axis]
    return [3 * sensor + axis for sensor in sensors for axis in axes]


def row_deviations(residuals: WhitenedResiduals) -> FloatArray:
    """Return the (N, 3K + 1) shift of each row alone in its standard errors: its square is the energy it explains."""
    return residuals.row_shift_T * np.sqrt(residuals.row_information)


def normal_of(
    residuals: WhitenedResiduals, samples: NDArray[np.intp], rows: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Return the information (S, r, r), 1/T², and the score (S, r), 1/T, of shifts of some rows in each sample.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Of all samples.
    samples : (S,) array of int
        Indices of the chosen samples.
    rows : sequence of int
        Indices of the r rows.
    """
    chosen = np.array(rows)
    slope = residuals.row_slope[samples][:, chosen] * np.isfinite(residuals.common_mode[samples, None])
    own = np.vstack([residuals.directions, np.zeros((1, residuals.directions.shape[1]))])[chosen]
    information: FloatArray = own @ own.T + slope[:, :, None] * slope[:, None, :]
    return information, (residuals.row_shift_T[samples] * residuals.row_information[samples])[:, chosen]


def explained_energy(residuals: WhitenedResiduals, samples: NDArray[np.intp], place: Place) -> FloatArray:
    """Return the energy (S,) of chosen samples that shifts of the rows of a place explain.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Of all samples.
    samples : (S,) array of int
        Indices of the chosen samples.
    place : Place
        Rows that are shifted, in each sample by its own amounts.
    """
    information, score = normal_of(residuals, samples, place.rows)
    return np.asarray(np.sum(score * np.linalg.solve(ridged(information), score[:, :, None])[:, :, 0], axis=1))


Key = tuple[int, int | None, str]
"""Sensor, axis and name of a term."""


@dataclass(frozen=True)
class Coefficient:
    """Name and SI unit of a coefficient of an effect, as people read it: "offset x", "T/K"."""

    name: str
    unit: str


@dataclass(frozen=True, eq=False)
class Term:
    """Coefficients that are selected together, and the regressor of each in the rows.

    Atom j adds ``features[:, j]`` to row ``rows[j]`` per unit of coefficient ``columns[j]``; where several rows read
    the same course, it adds ``rows[j, r]`` times that to each row r.

    Parameters
    ----------
    sensor : int
        Index of the sensor, or ``SCALAR`` or ``ALL``.
    axis : int, optional
        Index of the axis, where a single one is affected.
    name : str
        For example "offset"; unique among the terms of the same sensor and axis.
    coefficients : tuple of Coefficient
        P of them.
    features : (N, J) array
        In tesla per unit of the coefficient.
    rows : (J,) array of int, or (J, 3K + 1) array
        Row of each atom, or what each row reads of it.
    columns : (J,) array of int
        Coefficient of each atom.
    """

    sensor: int
    axis: int | None
    name: str
    coefficients: tuple[Coefficient, ...]
    features: FloatArray
    rows: NDArray[np.intp] | FloatArray
    columns: NDArray[np.intp]

    @classmethod
    def of_row(
        cls, covariates: Covariates, row: int, name: str, coefficients: Sequence[Coefficient], features: FloatArray
    ) -> "Term":
        """Make the term of one row whose coefficients have a feature each, (N, P).

        Parameters
        ----------
        covariates : Covariates
            Tell which row is the scalar magnetometer's.
        row : int
            Row of a sample: 3 i + a for axis a of sensor i, or the last for the scalar.
        name : str
            Name of the term.
        coefficients : sequence of Coefficient
            P of them.
        features : (N, P) array
            Regressor of each coefficient, tesla per unit of the coefficient.
        """
        sensor, axis = (SCALAR, None) if row == covariates.scalar_row else divmod(row, 3)
        return cls(sensor, axis, name, tuple(coefficients), features, *_of_row(row, len(coefficients)))

    @property
    def key(self) -> Key:
        """Sensor, axis and name, unique within an effect."""
        return self.sensor, self.axis, self.name

    def signal(self, values: FloatArray, row_count: int) -> FloatArray:
        """Return what coefficients (P,) add to the rows, (N, row_count), tesla.

        Parameters
        ----------
        values : (P,) array
            Coefficients in their SI units.
        row_count : int
            Number of rows, 3K + 1.
        """
        if self.rows.ndim == 2:
            return (self.features * values[self.columns]) @ self.rows
        added = np.zeros((len(self.features), row_count))
        for atom, (row, column) in enumerate(zip(self.rows, self.columns, strict=True)):
            added[:, row] += values[column] * self.features[:, atom]
        return added


def at_rows(values: NDArray[Any], rows: NDArray[Any]) -> NDArray[Any]:
    """Return values by row (3K + 1, ...) as those of atoms (J, ...).

    Parameters
    ----------
    values : (3K + 1, ...) array
        Linear in a shift of each row.
    rows : (J,) array of int, or (J, 3K + 1) array
        As those of a ``Term``.
    """
    return values[rows] if rows.ndim == 1 else np.tensordot(rows, values, 1)


def chosen(terms: Iterable[Term], keys: Sequence[Key]) -> list[Term]:
    """Return those of an effect's terms that have some keys, in the order of these.

    Parameters
    ----------
    terms : iterable of Term
        All terms of an effect.
    keys : sequence of tuple
        Sensor, axis and name of each term to return; all must exist.
    """
    wanted = set(keys)
    found = {term.key: term for term in terms if term.key in wanted}
    return [found[key] for key in keys]


def thinned(terms: Iterable[Term], stride: int) -> Iterator[Term]:
    """Yield terms at every stride-th sample; terms that share features still share them.

    Parameters
    ----------
    terms : iterable of Term
        Terms with features at all samples.
    stride : int
        Distance of the samples that are kept.
    """
    known: dict[int, tuple[ref[FloatArray], FloatArray]] = {}
    for term in terms:
        whole, own = known.get(id(term.features), (None, term.features))
        if whole is None or whole() is not term.features:
            own = term.features[::stride].copy()
            known[id(term.features)] = ref(term.features), own
        kept = replace(term, features=own)
        del term  # so that its features need not stand beside those of the next
        yield kept


@cache
def _of_row(row: int, count: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of atoms that are all of one row."""
    rows, columns = np.full(count, row), np.arange(count)
    rows.flags.writeable = columns.flags.writeable = False
    return rows, columns
