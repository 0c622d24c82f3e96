"""A bias that jumps, once or on and off."""

from tam_calibration.effects.effect import Covariates
from tam_calibration.effects.states import StepEffect, is_on
from tam_calibration.effects.term import Coefficient, Term
from tam_calibration.model.fitted_effect import Shape


class BiasJump(StepEffect):
    """Offsets of axes change at one time, for good or until another time."""

    name = "bias_jump"

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return an offset of each row from the one time on, until the other where there is one.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_s`` of the jump and, where it ends, ``end_s``, seconds.
        """
        step = is_on(covariates.time_s, shape)[:, None].astype(float)
        parts = [Coefficient("offset", "T")]
        return [Term.of_row(covariates, row, "offset", parts, step) for row in range(covariates.scalar_row + 1)]
