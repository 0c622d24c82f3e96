"""An ambient field whose intensity drifts in time against the scalar reference."""

from collections.abc import Iterable

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.effects.effect import Covariates, FittedEffect, Limit, LinearEffect, Shape, Sized
from tam_calibration.effects.grades import LONGEST_BURST
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals

ORDERS = ((1, 2), (3, 4), (5, 8), (9, 16), (17, 32))
"""Orders of the functions of a free course in time that stand or fall together, by octaves."""

_RATE = "rate of change"
_STORM = Limit(
    5e-7 / 60,
    "480 nT in a minute took down the grid of Quebec in the storm of March 1989; Kappenman, Great geomagnetic storms "
    "and extreme impulsive geomagnetic field disturbance events, Adv. Space Res. 38, 2006, p. 188",
    "T/s",
)
"""Root of the mean square of a drift's rate."""


class GeomagneticDrift(LinearEffect):
    """The intensity at the array drifts against the reference: a free, slow function of time on the scalar row.

    A drift of the vector turns with the array, yet changes the intensity by its part along the field, whatever the
    attitude; the differences between the sensors do not see it.
    """

    name = "geomagnetic_drift"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the recording is too short, where it is."""
        if covariates.sample_count < LONGEST_BURST * ORDERS[0][1]:
            return f"{covariates.sample_count} samples are too few for a free function of time"
        return None

    def sizes(self, covariates: Covariates, fitted: FittedEffect) -> list[Sized]:
        """Return how fast the drift is beside the fastest storm: the root of the mean square of its rate.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        fitted : FittedEffect
            Coefficients of the drift on the scalar row.
        """
        drift = self.signal(covariates, fitted)[:, -1]
        rate = np.diff(drift) / np.diff(covariates.time_s)
        return [Sized(_RATE, float(np.sqrt(np.mean(rate**2))), _STORM)] if len(rate) else []

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return the span of time of the recording.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the span follows from the times.
        """
        start, stop = float(covariates.time_s[0]), float(covariates.time_s[-1])
        return ({"start_s": start, "span_s": stop - start},)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return Legendre polynomials of time, held at their last value outside the span.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``start_s`` and ``span_s``, over which the polynomials are defined, seconds.
        """
        phase = np.clip(2 * (covariates.time_s - shape["start_s"]) / shape["span_s"] - 1, -1, 1)
        functions = legvander(phase, ORDERS[-1][1])
        row = covariates.scalar_row
        return [
            Term.of_row(
                covariates,
                row,
                f"orders {first} to {last}",
                [Coefficient(f"order {order}", "T") for order in range(first, last + 1)],
                functions[:, first : last + 1],
            )
            for first, last in ORDERS
        ]
