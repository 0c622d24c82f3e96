"""An axis whose reading is not linear in the field along it."""

from collections.abc import Iterable

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term, WhitenedResiduals
from tam_calibration.effects.grades import MINOR

_ORDERS = {"quadratic": (2,), "cubic": (3,), "higher": (4, 5), "highest": (6, 7, 8, 9)}
"""Orders of the polynomials that stand or fall together, by name: bends, and kinks as of a limit that is soft."""


class Nonlinearity(LinearEffect):
    """The reading of an axis is a curve of the field along it."""

    name = "nonlinearity"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that no axis was turned far enough, where it is so."""
        spread = float(np.ptp(covariates.sensed_T, axis=0).max() / covariates.intensity_T.max())
        if spread < MINOR:
            return f"no axis sees the field change by more than {100 * spread:.2g} % of its length"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the largest field as the full scale.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the full scale follows from the field.
        """
        return ({"full_scale_T": full_scale(covariates)},)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return Legendre polynomials of degree 2 to 9 of the field along each axis.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``full_scale_T``, the field that the polynomials are scaled by, tesla.
        """
        terms = []
        for row in range(covariates.scalar_row):
            curves = legvander(covariates.sensed_T[:, row] / shape["full_scale_T"], 9)
            for name, orders in _ORDERS.items():
                parts = [Coefficient(f"P{order}", "T") for order in orders]
                terms.append(Term.of_row(covariates, row, name, parts, curves[:, list(orders)]))
        return terms


def full_scale(covariates: Covariates) -> float:
    """Return the largest field along any axis, tesla."""
    return float(np.abs(covariates.sensed_T).max())
