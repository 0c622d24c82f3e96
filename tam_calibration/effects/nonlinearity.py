"""An axis whose reading is not linear in the field along it."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.effect import Coefficient, Limit, LinearEffect, Misfit, Shape, Situation, Term
from tam_calibration.effects.grades import MINOR

_ORDERS = {"quadratic": (2,), "cubic": (3,), "higher": (4, 5), "highest": (6, 7, 8, 9)}
"""Orders of the polynomials that stand or fall together, by name: bends, and kinks as of a limit that is soft."""


class Nonlinearity(LinearEffect):
    """The reading of an axis is a curve of the field along it."""

    name: ClassVar[str] = "nonlinearity"
    title: ClassVar[str] = "reading that is a curve of the field"
    physics: ClassVar[str] = (
        "Finite loop gain, converters and unsymmetric cores bend the transfer function of a magnetometer "
        "(Ripka, Magnetic Sensors and Magnetometers, Artech House, 2001, chapter 3); P_k are Legendre polynomials of "
        "the field over its full scale."
    )
    excitation: ClassVar[str] = "turn each axis along and against the field"
    within: ClassVar[tuple[str, ...]] = ("hysteresis",)
    shape_units: ClassVar[dict[str, str]] = {"full_scale_T": "T"}
    largest_signal: ClassVar[Limit | None] = Limit(
        0.1,
        "the linearity error of magnetoresistive sensors is up to 2 % of 200 µT, 8 % of the Earth's field; Honeywell, "
        "data sheet of the HMC1001",
    )

    def obstacle(self, situation: Situation) -> str | None:
        """Return that no axis was turned far enough, where it is so."""
        spread = float(np.ptp(situation.sensed_T, axis=0).max() / situation.intensity_T.max())
        if spread < MINOR:
            return f"no axis sees the field change by more than {100 * spread:.2g} % of its length"
        return None

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return the largest field as the full scale."""
        return ({"full_scale_T": full_scale(situation)},)

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return Legendre polynomials of degree 2 to 9 of the field along each axis."""
        terms = []
        for row in range(situation.scalar_row):
            curves = legvander(situation.sensed_T[:, row] / shape["full_scale_T"], 9)
            for name, orders in _ORDERS.items():
                parts = [Coefficient(f"P{order}", "T") for order in orders]
                terms.append(Term.of_row(situation, row, name, parts, curves[:, list(orders)]))
        return terms


def full_scale(situation: Situation) -> float:
    """Return the largest field along any axis, tesla."""
    return float(np.abs(situation.sensed_T).max())
