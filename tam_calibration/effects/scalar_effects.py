"""Effects of the scalar reference: an ambient field that drifts, and readings that depend on the heading."""

from collections.abc import Iterable

import numpy as np
from numpy.polynomial.legendre import legvander

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.effect import Covariates, FittedEffect, Limit, LinearEffect, Shape, Sized
from tam_calibration.effects.grades import LONGEST_BURST, SLIGHT
from tam_calibration.effects.laws import angles_of, axis_at, order_terms, scalar_term
from tam_calibration.effects.term import Term, WhitenedResiduals

ORDERS = ((1, 2), (3, 4), (5, 8), (9, 16), (17, 32))
"""Orders of the functions of a free course in time that stand or fall together, by octaves."""

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
        return [Sized("rate of change", float(np.sqrt(np.mean(rate**2))), _STORM)] if len(rate) else []

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
        groups = {f"orders {first} to {last}": range(first, last + 1) for first, last in ORDERS}
        return order_terms(covariates, covariates.scalar_row, groups, "order ", legvander(phase, ORDERS[-1][1]))


_AXIS_ORDERS = ((3,), (4,), (5, 6), (7, 8), (9, 10), (11, 12))
"""Of the polynomials about one axis that stand or fall together; dead zones are sharp."""


class ScalarHeadingError(LinearEffect):
    """The scalar reading is off by a function of the direction of the field in the array frame.

    Up to the second degree such a function is inside the calibration; what can be seen begins with the third.
    """

    name = "scalar_heading_error"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the directions are too few to tell a third degree from a calibration error, where they are."""
        functions = harmonics(covariates.field_T / covariates.intensity_T[:, None], 3)
        scatter = functions.T @ functions
        # A calibration error makes any of the nine harmonics up to degree 2: they are eliminated.
        own, both, others = scatter[:9, :9], scatter[9:, :9], scatter[9:, 9:]
        left = others - both @ np.linalg.pinv(own, rcond=1e-9, hermitian=True) @ both.T
        if np.trace(left) < SLIGHT**2 * np.trace(others):
            return "the field does not come from enough directions"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return any function of the direction, and functions of the angle to 96 axes, fourteen degrees apart.

        They lie evenly over half the sphere: opposite axes have the same polynomials but for signs.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the directions are fixed.
        """
        index = np.arange(96)
        z, azimuth = 1 - (index + 0.5) / 96, np.pi * (1 + np.sqrt(5)) * index
        flat = np.sqrt(1 - z**2)
        return [{}, *angles_of(np.column_stack([flat * np.cos(azimuth), flat * np.sin(azimuth), z]))]

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
        if "azimuth_rad" in shape:
            curves = legvander(np.clip(direction @ axis_at(shape), -1, 1), _AXIS_ORDERS[-1][-1])
            groups = {f"about an axis, degree {orders[0]}": orders for orders in _AXIS_ORDERS}
            return order_terms(covariates, covariates.scalar_row, groups, "P", curves)
        functions = harmonics(direction, 6)
        return [
            scalar_term(
                covariates,
                f"degree {degree}",
                {f"degree {degree}, order {order}": "T" for order in range(-degree, degree + 1)},
                functions[:, degree**2 : (degree + 1) ** 2],
            )
            for degree in (3, 4, 5, 6)
        ]
