"""Sensors that their own weight turns out of place."""

import numpy as np

from tam_calibration.effects.covariates import LEAST_TURN, upwards
from tam_calibration.effects.effect import Coefficient, Covariates, LinearEffect, Shape, Term


class Flexure(LinearEffect):
    """A sensor turns against the array by ω = C u, with u the direction upwards: it reads M (b + ω × b)."""

    name = "flexure"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the array was not tilted, or that its sensor has none to turn against, where it is so."""
        if covariates.sensor_count < 2 and not covariates.follows_attitude:
            return "a turn of a single sensor does not change the length of the field"
        up = upwards(covariates)
        tilt = float(np.sqrt(np.mean(np.sum((up - up.mean(axis=0)) ** 2, axis=1))))
        if tilt < LEAST_TURN:
            return f"the array is tilted by {tilt:.2f} rad only"
        return None

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return the nine elements of C of each sensor.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            Not used: this effect has no shape parameters.
        """
        up, field = upwards(covariates), covariates.field_T
        terms = []
        for sensor, matrix in enumerate(covariates.errors.matrix):
            # (ω × b) for ω along each axis, as the sensor reads it: (N, row, ω).
            turned = np.stack([np.cross(axis, field) @ matrix.T for axis in np.eye(3)], axis=2)
            features = (turned[:, :, :, None] * up[:, None, None, :]).reshape(len(up), 27)
            names = [f"turn about {axis} by weight along {other}" for axis in "xyz" for other in "xyz"]
            parts = tuple(Coefficient(name, "rad") for name in names)
            rows, columns = np.divmod(np.arange(27), 9)
            terms.append(Term(sensor, None, "turn", parts, features, 3 * sensor + rows, columns))
        return terms
