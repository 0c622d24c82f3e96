"""The field of a current near the sensors."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.effects.covariates import lagged
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape
from tam_calibration.effects.grades import NEGLIGIBLE
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals

_LAGS = (1.0, 5.0, 25.0, 125.0)
"""Time constants of a lagged part, in steps of time."""


class CurrentInterference(LinearEffect):
    """A current that is fixed to the array adds a field in proportion to it."""

    name = "current_interference"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the current is constant, where it is."""
        assert covariates.current_A is not None
        low, high = np.quantile(covariates.current_A, (0.01, 0.99))
        if high - low <= NEGLIGIBLE * max(abs(low), abs(high)):
            return f"the current changes by {high - low:.2g} A only"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the field without a lagged part, then with one.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the lags follow from the time step.
        """
        assert covariates.current_A is not None
        reference = {"reference_A": float(np.mean(covariates.current_A))}
        return [reference, *({**reference, "time_constant_s": lag * covariates.step_s} for lag in _LAGS)]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the field of the current at each axis and along the field at the scalar, its second order and lag.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``reference_A``, ampere, and with a lagged part ``time_constant_s``, seconds.
        """
        assert covariates.current_A is not None
        current = covariates.current_A - shape["reference_A"]
        features = [("field", "T/A", current[:, None]), ("quadratic", "T/A²", current[:, None] ** 2)]
        if "time_constant_s" in shape:
            late = current - lagged(current, covariates.time_s, shape["time_constant_s"], covariates.memory)
            features.append(("lagged", "T/A", late[:, None]))
        terms = [
            Term.of_row(covariates, row, name, [Coefficient(name, unit)], feature)
            for name, unit, feature in features
            for row in range(covariates.scalar_row)
        ]
        along = covariates.field_T / covariates.intensity_T[:, None] * current[:, None]
        parts = [Coefficient(f"field {axis}", "T/A") for axis in "xyz"]
        return [*terms, Term.of_row(covariates, covariates.scalar_row, "field", parts, along)]
