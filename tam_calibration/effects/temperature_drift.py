"""Bias and scale factor that drift with temperature."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.effects.covariates import lagged
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape
from tam_calibration.effects.term import Coefficient, Term, WhitenedResiduals

_LEAST_CHANGE_K = 0.2
"""Least change of temperature, K: less is the noise of usual thermometers."""

_SHORTEST = 1 / 200
"""Shortest lag, as a part of the recording's duration."""

_LONGEST = 1 / 3
"""Longest lag, as a part of the recording's duration: a longer one is a drift with time."""

_COUNT = 5
"""Time constants that are tried, before refinement."""

_INNER_SHARES = (0.0, 0.5)
"""Share of the inner layer in the total time constant; at most a half, as their order does not matter."""


class TemperatureDrift(LinearEffect):
    """Bias and scale factor of an axis follow the temperature, with a lag."""

    name = "temperature_drift"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the temperature is constant, where it is."""
        assert covariates.temperature_C is not None
        low, high = np.quantile(covariates.temperature_C, (0.01, 0.99))
        if high - low < _LEAST_CHANGE_K:
            return f"the temperature changes by {high - low:.2g} K only"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return lags from none to a third of the record, of one layer and of two alike.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        residuals : WhitenedResiduals
            Not used: the lags follow from the duration.
        """
        assert covariates.temperature_C is not None
        span = float(covariates.time_s[-1] - covariates.time_s[0])
        reference = {"reference_C": float(np.mean(covariates.temperature_C))}
        constants = np.geomspace(_SHORTEST * span, _LONGEST * span, _COUNT).tolist()
        lags = [
            {"time_constant_s": constant, "inner_share": share} for constant in constants for share in _INNER_SHARES
        ]
        start = {"start_s": float(covariates.time_s[0])}
        return [{"time_constant_s": 0.0} | reference, *(lag | reference | start for lag in lags)]

    def terms(self, covariates: Covariates, shape: Shape) -> list[Term]:
        """Return drifts of offset and scale, the second order of the offset, and how the start settles.

        Parameters
        ----------
        covariates : Covariates
            Time, field in the array frame and recorded channels of the N samples.
        shape : Shape
            ``time_constant_s`` and ``start_s``, seconds, ``reference_C``, °C, and ``inner_share``, part of the lag.
        """
        assert covariates.temperature_C is not None
        inner = shape.get("inner_share", 0.0) * shape["time_constant_s"]
        outer = shape["time_constant_s"] - inner
        change = covariates.temperature_C - shape["reference_C"]
        for constant in (outer, inner):
            change = lagged(change, covariates.time_s, constant, covariates.memory)
        parts = [("offset", "T/K", change), ("quadratic offset", "T/K²", change**2)]
        if "start_s" in shape:
            since = covariates.time_s - shape["start_s"]
            left = np.exp(-np.maximum(since, 0.0) / outer) if outer > 0 else since == 0
            parts.append(("start", "T", np.where(since < 0, 0.0, left)))
        return [
            Term.of_row(covariates, row, name, [Coefficient(name, unit)], feature[:, None])
            for row in range(covariates.scalar_row)
            for name, unit, feature in (*parts, ("scale", "1/K", change * covariates.sensed_T[:, row]))
        ]
