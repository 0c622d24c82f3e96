"""The grade of a calibration: whether it can be used, what speaks against it, and what to do next."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from tam_calibration.model.residuals import Residuals
from tam_calibration.model.units import to_nanotesla

Grade = Literal["good", "doubtful", "bad"]


@dataclass(frozen=True)
class Quality:
    """A grade with its reasons.

    Parameters
    ----------
    grade : str
        "good": use it. "doubtful": its errors may be larger than its standard errors say. "bad": do not use it.
    reasons : tuple of str
        What speaks against the calibration, the gravest first; empty where it is good.
    next : tuple of str
        What to do about each reason: an action or a command.
    headline : str
        The residual and its noise floor; empty without a calibration.
    """

    grade: Grade
    reasons: tuple[str, ...] = ()
    next: tuple[str, ...] = ()
    headline: str = ""

    def __str__(self) -> str:
        """Return the grade, the residual and its floor, and the gravest reason with what to do, on one line."""
        return f"{self.grade.capitalize()}: {'; '.join(filter(None, (self.headline, *self.reasons[:1])))}"


def quality_for(grade: Grade, reasons: Sequence[str], headline: str = "") -> Quality:
    """Return the quality for reasons that say what is wrong and, behind the last colon, what to do."""
    actions = dict.fromkeys(reason.rpartition(": ")[2] for reason in reasons if ": " in reason)
    return Quality(grade, tuple(reason.rstrip(".") for reason in reasons), tuple(actions), headline)


def residual_in_words(residual: Residuals, floor: Residuals, seen: str) -> str:
    """Return a residual and its noise floor: of the tensor, or of |B| if the array measures no gradient.

    Parameters
    ----------
    residual, floor : Residuals
        Of corrected readings, and what sensor noise alone makes.
    seen : str
        Which samples they are of.
    """
    name, unit, sizes = "tensor", "nT/m", (residual.tensor_rmse_T_per_m, floor.tensor_rmse_T_per_m)
    if np.isnan(sizes[0]):
        name, unit, sizes = "|B|", "nT", (residual.sensors_rms_T, floor.sensors_rms_T)
    left, least = (f"{to_nanotesla(size):.4g} {unit}" for size in sizes)
    return f"{name} residual {left} on {seen}, noise floor {least}"
