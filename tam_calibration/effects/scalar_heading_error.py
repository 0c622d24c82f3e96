"""A scalar magnetometer whose reading depends on the direction of the field."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.grades import SLIGHT
from tam_calibration.model.units import FloatArray

_NUISANCE_COUNT = 9
"""Harmonics up to degree 2: a calibration error makes any of them."""

_DEGREES = (3, 4, 5, 6)
"""Of the harmonics for any function of the direction: the lowest that no calibration error makes."""

_AXIS_ORDERS = ((3,), (4,), (5, 6), (7, 8), (9, 10), (11, 12))
"""Of the polynomials about one axis that stand or fall together; dead zones are sharp."""

_GRID = 400
"""Axes of the first grid, seven degrees apart on half the sphere."""

_AXES = 3
"""Axes of the grid that are refined, as the best one need not lead to the optimum."""

_APART = 0.3
"""Least angle between two axes that are tried, radians."""

_CAPS = (0.1, 0.04, 0.016, 0.006)
"""Radii of the caps in which an axis is refined, rad: each is the spacing of the axes of the previous one."""

_CAP_GRID = 30
"""Axes in each cap."""

_PRECISE = 1e-9
"""Rounding error of normal equations, relative."""


class ScalarHeadingError(LinearEffect):
    """The scalar reading is off by a function of the direction of the field in the array frame.

    Up to the second degree such a function is inside the calibration; what can be seen begins with the third.
    """

    name = "scalar_heading_error"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the directions are too few to tell a third degree from a calibration error, where they are."""
        functions = harmonics(covariates.field_T / covariates.intensity_T[:, None], 3)
        scatter = functions.T @ functions
        left = _without_lower(scatter)
        if np.trace(left) < SLIGHT**2 * np.trace(scatter[_NUISANCE_COUNT:, _NUISANCE_COUNT:]):
            return "the field does not come from enough directions"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return any function of the direction, and functions of the angle to the axes that explain most.

        Parameters
        ----------
        covariates : Covariates
            Not used: those of the residuals are taken.
        residuals : WhitenedResiduals
            Of N samples of the recording.
        """
        return [{}, *({"azimuth_rad": azimuth, "elevation_rad": elevation} for azimuth, elevation in _axes(residuals))]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return spherical harmonics of degrees 3 to 6, or Legendre polynomials about an axis of degrees 3 to 12.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Empty, or ``azimuth_rad``, ``elevation_rad`` of an axis in the array frame, rad.
        """
        direction = covariates.field_T / covariates.intensity_T[:, None]
        row = covariates.scalar_row
        if "azimuth_rad" in shape:
            axis = _axis(shape["azimuth_rad"], shape["elevation_rad"])
            curves = legvander(np.clip(direction @ axis, -1, 1), _AXIS_ORDERS[-1][-1])
            return [
                Term.of_row(
                    covariates,
                    row,
                    f"about an axis, degree {orders[0]}",
                    [Coefficient(f"P{order}", "T") for order in orders],
                    curves[:, list(orders)],
                )
                for orders in _AXIS_ORDERS
            ]
        functions = harmonics(direction, _DEGREES[-1])
        terms = []
        for degree in _DEGREES:
            parts = [Coefficient(f"degree {degree}, order {order}", "T") for order in range(-degree, degree + 1)]
            own = functions[:, degree**2 : (degree + 1) ** 2]
            terms.append(Term.of_row(covariates, row, f"degree {degree}", parts, own))
        return terms


def _axis(azimuth: float, elevation: float) -> FloatArray:
    flat = np.cos(elevation)
    return np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])


@dataclass(frozen=True, eq=False)
class _AxisSearch:
    """Normal equations of the harmonics of degree 3 and more in the common mode, the lower ones eliminated."""

    information: FloatArray
    score: FloatArray

    def gain(self, axes: FloatArray) -> FloatArray:
        """Return the gain (A,) of Legendre polynomials about axes (A, 3).

        By the addition theorem that of degree l is the sum of the harmonics of degree l, each times its own value at
        the axis.
        """
        values = harmonics(axes, _DEGREES[-1])[:, _NUISANCE_COUNT:]
        degree = np.repeat(_DEGREES, [2 * degree + 1 for degree in _DEGREES])
        polynomials = np.where(degree == np.array(_DEGREES)[:, None], values[:, None], 0.0)
        score = polynomials @ self.score
        information = polynomials @ self.information @ np.swapaxes(polynomials, 1, 2)
        step = np.linalg.pinv(information, rcond=_PRECISE, hermitian=True) @ score[:, :, None]
        return np.asarray(np.sum(score * step[:, :, 0], axis=1))


def _axes(residuals: WhitenedResiduals) -> list[tuple[float, float]]:
    """Return azimuth and elevation of the axes that explain most, best first."""
    used = residuals.is_counted & np.isfinite(residuals.common_mode)
    if used.sum() < 2 * _NUISANCE_COUNT:
        return []
    covariates = residuals.covariates
    direction = covariates.field_T[used] / covariates.intensity_T[used, None]
    functions = harmonics(direction, _DEGREES[-1]) * residuals.row_slope[used, -1:]
    score = functions.T @ residuals.common_mode[used]
    information = functions.T @ functions
    left = _without_lower(np.column_stack([information, score]))
    search = _AxisSearch(left[:, :-1], left[:, -1])
    grid = _spiral(_GRID, 1.0)
    found: list[FloatArray] = []
    for best in np.argsort(-search.gain(grid)):
        if all(abs(grid[best] @ axis) < np.cos(_APART) for axis in found):
            found.append(_climbed(search, grid[best]))
        if len(found) == _AXES:
            break
    return [(float(np.arctan2(axis[1], axis[0])), float(np.arcsin(axis[2]))) for axis in found]


def _climbed(search: _AxisSearch, axis: FloatArray) -> FloatArray:
    """Return the axis near another that explains most."""
    for size in _CAPS:
        cap = _spiral(_CAP_GRID, 1 - np.cos(size))
        # Any rotation that brings the z axis to the axis so far.
        basis, _ = np.linalg.qr(np.column_stack([axis, np.eye(3)[np.argsort(np.abs(axis))[:2]].T]))
        near = np.vstack([axis, cap @ np.column_stack([basis[:, 1:], axis]).T])
        axis = near[np.argmax(search.gain(near))]
    return axis


def _spiral(count: int, height: float) -> FloatArray:
    """Return directions (count, 3) evenly over the cap of a height about z; that of 1 is half the sphere.

    Legendre polynomials about opposite axes are the same but for signs.
    """
    z = 1 - height * (np.arange(count) + 0.5) / count
    azimuth = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z])


def _without_lower(information: FloatArray) -> FloatArray:
    """Return normal equations (P, P) or (P, P + 1) with the harmonics up to degree 2 eliminated."""
    count = _NUISANCE_COUNT
    own, other = information[:count, :count], information[count:, :count]
    return (
        information[count:, count:]
        - other @ np.linalg.pinv(own, rcond=_PRECISE, hermitian=True) @ (information[:count, count:])
    )
