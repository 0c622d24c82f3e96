"""A scale factor, or the whole response of a sensor, that changes at once."""

import numpy as np

from tam_calibration.effects.effect import Covariates, Shape
from tam_calibration.effects.states import StepEffect, is_on
from tam_calibration.effects.term import Coefficient, Term

_SCALE = Coefficient("scale", "1")
_TURNS = tuple(Coefficient(f"turn about {axis}", "rad") for axis in "xyz")


class ScaleStep(StepEffect):
    """The response of a sensor changes at one time, for good or until another time: it reads (M + ΔM) b."""

    name = "scale_step"
    not_sought = ("tilt", "turn")

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return from the one time on a scale and a tilt of each axis and a turn of each sensor.

        The axes' scales and tilts together are any change of the response; what changes a scale amplifies the bias too.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_s`` of the step and, where it ends, ``end_s``, seconds.
        """
        since = is_on(covariates.time_s, shape)
        field = np.where(since[:, None], covariates.field_T, 0.0)
        matrix = covariates.errors.matrix
        sensed = field @ matrix.reshape(-1, 3).T
        amplified = np.where(since[:, None], sensed + covariates.errors.bias_T.ravel(), 0.0)
        terms = []
        for row in range(covariates.scalar_row):
            sensor, axis = divmod(row, 3)
            others = [other for other in range(3) if other != axis]
            tilts = [Coefficient(f"tilt towards {'xyz'[other]}", "rad") for other in others]
            terms.append(Term.of_row(covariates, row, "scale", [_SCALE], amplified[:, row, None]))
            terms.append(
                Term.of_row(covariates, row, "tilt", tilts, sensed[:, [3 * sensor + other for other in others]])
            )
        for sensor in range(covariates.sensor_count):
            turned = np.stack([np.cross(axis, field) @ matrix[sensor].T for axis in np.eye(3)], axis=2)
            rows, columns = np.divmod(np.arange(9), 3)
            terms.append(Term(sensor, None, "turn", _TURNS, turned.reshape(-1, 9), 3 * sensor + rows, columns))
        return terms
