"""Terms: regressors of an effect with their rows, and the laws of which most effects are made.

The laws are courses, gains, turns and matrices.
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, Shape
from tam_calibration.model.units import FloatArray

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
        count = len(coefficients)
        return cls(sensor, axis, name, tuple(coefficients), features, np.full(count, row), np.arange(count))

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


Units = Mapping[str, str]
"""SI units of the coefficients of a term, by their names."""


def matrix_units(prefix: str) -> Units:
    """Return names and units of the nine elements of a matrix, row by row."""
    return {f"{prefix}, {axis} of the field on {row}": "1" for row in "xyz" for axis in "xyz"}


def _coefficients(units: Units) -> tuple[Coefficient, ...]:
    return tuple(Coefficient(name, unit) for name, unit in units.items())


def course_terms(
    covariates: Covariates, name: str, units: Units, courses: FloatArray, with_scalar: bool = False
) -> list[Term]:
    """Return a term of each axis, and of the scalar if asked for, that adds courses (N, P) in tesla.

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    name : str
        Of the terms.
    units : mapping of str to str
        SI unit of each of the P coefficients.
    courses : (N, P) array
        Tesla per unit of the coefficient.
    with_scalar : bool
        Whether the scalar has such a term too.
    """
    parts = _coefficients(units)
    return [Term.of_row(covariates, row, name, parts, courses) for row in range(covariates.scalar_row + with_scalar)]


def axis_terms(covariates: Covariates, name: str, units: Units, features: FloatArray) -> list[Term]:
    """Return a term of each axis that has features of its own.

    Parameters
    ----------
    covariates : Covariates
        Of N samples of K sensors.
    name : str
        Of the terms.
    units : mapping of str to str
        SI unit of each of the P coefficients.
    features : (N, 3K, P) or (N, 3K) array
        Tesla per unit of the coefficient; two dimensions for one coefficient.
    """
    parts, features = _coefficients(units), features.reshape(*features.shape[:2], len(units))
    return [Term.of_row(covariates, row, name, parts, features[:, row]) for row in range(covariates.scalar_row)]


def sensor_terms(covariates: Covariates, name: str, units: Units, features: FloatArray) -> list[Term]:
    """Return a term of each sensor whose coefficients act on all its axes.

    Parameters
    ----------
    covariates : Covariates
        Of N samples of K sensors.
    name : str
        Of the terms.
    units : mapping of str to str
        SI unit of each of the P coefficients.
    features : (N, 3K, P) or (N, 3K) array
        Tesla per unit of the coefficient; two dimensions for one coefficient.
    """
    parts, count = _coefficients(units), len(features)
    rows, columns = np.divmod(np.arange(3 * len(parts)), len(parts))
    return [
        Term(sensor, None, name, parts, features[:, 3 * sensor : 3 * sensor + 3].reshape(count, -1), row, columns)
        for sensor, row in enumerate(rows + 3 * np.arange(covariates.sensor_count)[:, None])
    ]


def matrix_terms(covariates: Covariates, name: str, units: Units, vector: FloatArray) -> list[Term]:
    """Return a term of each sensor that adds a matrix (3, C) times a vector (N, C).

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    name : str
        Of the terms.
    units : mapping of str to str
        SI unit of each element of the matrix, row by row.
    vector : (N, C) array
        Tesla per unit of the elements.
    """
    parts, columns = _coefficients(units), np.arange(len(units))
    features = np.tile(vector, 3)
    return [
        Term(sensor, None, name, parts, features, 3 * sensor + columns // vector.shape[1], columns)
        for sensor in range(covariates.sensor_count)
    ]


def scalar_term(covariates: Covariates, name: str, units: Units, features: FloatArray) -> Term:
    """Return a term of the scalar with features (N, P), tesla per unit of the coefficient.

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    name : str
        Of the term.
    units : mapping of str to str
        SI unit of each of the P coefficients.
    features : (N, P) array
        Tesla per unit of the coefficient.
    """
    return Term.of_row(covariates, covariates.scalar_row, name, _coefficients(units), features)


def order_terms(
    covariates: Covariates, row: int, groups: Mapping[str, list[int]], prefix: str, functions: FloatArray
) -> list[Term]:
    """Return the terms of a row that add functions of some orders, in groups that are selected together.

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    row : int
        Row of a sample.
    groups : mapping of str to list of int
        Orders of the functions of each term, by its name.
    prefix : str
        Of the names of the coefficients, in front of the order.
    functions : (N, orders) array
        Functions without unit, by order; their coefficients are in tesla.
    """
    return [
        Term.of_row(covariates, row, name, [Coefficient(f"{prefix}{order}", "T") for order in own], functions[:, own])
        for name, own in groups.items()
    ]


def turned(covariates: Covariates, field_T: FloatArray) -> FloatArray:
    """Return what each axis reads more when its sensor turns about x, y or z, (N, 3K, 3), tesla per radian.

    Parameters
    ----------
    covariates : Covariates
        Of N samples of K sensors.
    field_T : (N, 3) array
        Field in the array frame.
    """
    matrix = covariates.errors.matrix.reshape(-1, 3)
    return np.stack([np.cross(axis, field_T) @ matrix.T for axis in np.eye(3)], axis=2)


def angles_of(directions: FloatArray) -> list[Shape]:
    """Return azimuth and elevation of directions (D, 3), radians, as parameters of shapes.

    Parameters
    ----------
    directions : (D, 3) array
        In the array frame, of any length.
    """
    x, y, z = directions.T
    angles = np.column_stack([np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))])
    return [{"azimuth_rad": azimuth, "elevation_rad": elevation} for azimuth, elevation in angles.tolist()]


def axis_at(shape: Shape) -> FloatArray:
    """Return the unit vector (3,) at the azimuth and elevation of a shape."""
    azimuth, elevation = shape["azimuth_rad"], shape["elevation_rad"]
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


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
