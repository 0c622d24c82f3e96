"""Laws of effects: terms for courses, gains, turns and matrices, of which most effects are made."""

from collections.abc import Mapping, Sequence

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.term import Coefficient, Term
from tam_calibration.model.fitted_effect import Shape
from tam_calibration.model.units import FloatArray

Units = Mapping[str, str]
"""SI units of the coefficients of a term, by their names."""

OF_MATRIX = tuple(f"{axis} of the field on {row}" for row in "xyz" for axis in "xyz")
"""Elements of a matrix, row by row."""


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


def matrix_terms(covariates: Covariates, name: str, prefix: str, change_T: FloatArray) -> list[Term]:
    """Return a term of each sensor that adds nine elements of a matrix times a vector (N, 3) in tesla.

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    name : str
        Of the terms.
    prefix : str
        Of the names of the coefficients.
    change_T : (N, 3) array
        The vector.
    """
    parts, columns = _coefficients({f"{prefix}, {of}": "1" for of in OF_MATRIX}), np.arange(9)
    features = np.tile(change_T, 3)
    return [
        Term(sensor, None, name, parts, features, 3 * sensor + columns // 3, columns)
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
    covariates: Covariates, row: int, groups: Mapping[str, Sequence[int]], prefix: str, functions: FloatArray
) -> list[Term]:
    """Return the terms of a row that add functions of some orders, in groups that are selected together.

    Parameters
    ----------
    covariates : Covariates
        Of N samples.
    row : int
        Row of a sample.
    groups : mapping of str to sequence of int
        Orders of the functions of each term, by its name.
    prefix : str
        Of the names of the coefficients, in front of the order.
    functions : (N, orders) array
        Functions without unit, by order; their coefficients are in tesla.
    """
    terms = []
    for name, orders in groups.items():
        parts = [Coefficient(f"{prefix}{order}", "T") for order in orders]
        terms.append(Term.of_row(covariates, row, name, parts, functions[:, list(orders)]))
    return terms


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
