"""The drift of an array's parameters over missions: a straight line through estimates with standard errors."""

import math
from dataclasses import dataclass

import numpy as np

from tam_calibration.units import FloatArray

SECONDS_PER_DAY = 86_400.0


@dataclass(frozen=True)
class Drift:
    """The line through one parameter over the missions; NaN is what they do not tell.

    Parameters
    ----------
    missions : int
        Estimates that have a standard error.
    mean, mean_standard_error : float
        Weighted mean.
    per_day, per_day_standard_error : float
        Slope of the line, in the parameter's unit.
    scatter : float
        Of the estimates about the line, in their standard errors: √(χ²/(missions - 2)). Where it is above 1, the
        missions differ by more than the calibrations know of, and all standard errors here are wider by it.
    """

    missions: int
    mean: float
    mean_standard_error: float
    per_day: float
    per_day_standard_error: float
    scatter: float

    @property
    def significance(self) -> float:
        """Slope over its standard error."""
        return self.per_day / self.per_day_standard_error


def fit_drift(time_s: FloatArray, values: FloatArray, standard_errors: FloatArray) -> Drift | None:
    """Fit a line through estimates by weighted least squares.

    Parameters
    ----------
    time_s, values, standard_errors : (M,) array
        Of each mission; a standard error of zero marks what was held fixed, NaN what is not known.

    Returns
    -------
    Drift or None
        None where no mission tells the parameter.
    """
    known = np.isfinite(values) & (standard_errors > 0)
    count = int(known.sum())
    if not count:
        return None
    days, value = time_s[known] / SECONDS_PER_DAY, values[known]
    weight = standard_errors[known] ** -2.0
    total = float(weight.sum())
    mean, middle = float(weight @ value) / total, float(weight @ days) / total
    since = days - middle
    spread = float(weight @ since**2)
    if count == 1 or spread == 0:
        return Drift(count, mean, total**-0.5, math.nan, math.nan, math.nan)
    slope = float(weight @ (since * (value - mean))) / spread
    scatter = math.nan
    if count > 2:
        scatter = math.sqrt(float(weight @ (value - mean - slope * since) ** 2) / (count - 2))
    wider = max(1.0, scatter) if count > 2 else 1.0
    return Drift(count, mean, wider * total**-0.5, slope, wider * spread**-0.5, scatter)
