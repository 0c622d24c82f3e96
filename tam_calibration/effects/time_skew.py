"""A sensor or axis that is sampled later than the others."""

import numpy as np

from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term
from tam_calibration.effects.motion import jumps, rates

_DELAY = Coefficient("delay", "s")


class TimeSkew(LinearEffect):
    """What is read was sensed a delay before: b(t - δ) = b - δ db/dt; uses samples on both sides."""

    name = "time_skew"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(covariates)

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return delays of a sensor, of a single axis and of the scalar magnetometer.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Not used: this effect has no shape parameters.
        """
        field_rate = rates(covariates)
        late = -field_rate @ covariates.errors.matrix.reshape(-1, 3).T
        terms = []
        for sensor in range(covariates.sensor_count):
            rows = np.arange(3 * sensor, 3 * sensor + 3)
            terms.append(Term(sensor, None, "delay", (_DELAY,), late[:, rows], rows, np.zeros(3, dtype=int)))
        for row in range(covariates.scalar_row):
            terms.append(Term.of_row(covariates, row, "delay of the axis", [_DELAY], late[:, row, None]))
        intensity_rate = np.sum(covariates.field_T * field_rate, axis=1) / covariates.intensity_T
        terms.append(Term.of_row(covariates, covariates.scalar_row, "delay", [_DELAY], -intensity_rate[:, None]))
        return terms
