"""A scalar magnetometer whose reading depends on the direction of the field."""

from collections.abc import Iterable

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

_GRID = 96
"""Axes that are tried, fourteen degrees apart on half the sphere; the best is refined."""

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
        """Return any function of the direction, and functions of the angle to axes in all directions.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the directions are fixed.
        """
        azimuth, elevation = np.arctan2(_AXES[:, 1], _AXES[:, 0]).tolist(), np.arcsin(_AXES[:, 2]).tolist()
        names = "azimuth_rad", "elevation_rad"
        return [{}, *(dict(zip(names, angles, strict=True)) for angles in zip(azimuth, elevation, strict=True))]

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


def _directions() -> FloatArray:
    """Return directions (D, 3) evenly over half the sphere: opposite axes have the same polynomials but for signs."""
    z = 1 - (np.arange(_GRID) + 0.5) / _GRID
    azimuth = np.pi * (1 + np.sqrt(5)) * np.arange(_GRID)
    flat = np.sqrt(1 - z**2)
    return np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z])


def _without_lower(information: FloatArray) -> FloatArray:
    """Return normal equations (P, P) of harmonics with those up to degree 2 eliminated."""
    count = _NUISANCE_COUNT
    own, other = information[:count, :count], information[count:, :count]
    eliminated = other @ np.linalg.pinv(own, rcond=_PRECISE, hermitian=True) @ information[:count, count:]
    return np.asarray(information[count:, count:] - eliminated)


_AXES = _directions()
