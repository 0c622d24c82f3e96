"""Effects that follow a recorded channel: temperature, current, and attitude by the weight of the sensors."""

from collections.abc import Iterable

import numpy as np

from tam_calibration.effects.covariates import LEAST_TURN, lagged, upwards
from tam_calibration.effects.effect import Covariates, LinearEffect, Shape
from tam_calibration.effects.grades import NEGLIGIBLE
from tam_calibration.effects.laws import axis_terms, course_terms, scalar_term, sensor_terms, turned
from tam_calibration.effects.term import Term, WhitenedResiduals


class TemperatureDrift(LinearEffect):
    """Bias and scale factor of an axis follow the temperature, with a lag."""

    name = "temperature_drift"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that the temperature is constant, where it is."""
        assert covariates.temperature_C is not None
        low, high = np.quantile(covariates.temperature_C, (0.01, 0.99))
        if high - low < 0.2:  # the noise of usual thermometers
            return f"the temperature changes by {high - low:.2g} K only"
        return None

    def shapes(self, covariates: Covariates, residuals: WhitenedResiduals) -> Iterable[Shape]:
        """Return lags from none to a third of the record, of one layer and of two alike.

        A longer lag is a drift with time. As the order of the layers does not matter, the inner one has at most half.

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
        lags = [
            {"time_constant_s": constant, "inner_share": share}
            for constant in np.geomspace(span / 200, span / 3, 5).tolist()
            for share in (0.0, 0.5)
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
        terms = [
            term
            for name, unit, course in parts
            for term in course_terms(covariates, name, {name: unit}, course[:, None])
        ]
        return terms + axis_terms(covariates, "scale", {"scale": "1/K"}, change[:, None] * covariates.sensed_T)


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
        lags = (1.0, 5.0, 25.0, 125.0)
        return [reference, *({**reference, "time_constant_s": lag * covariates.step_s} for lag in lags)]

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
        current = (covariates.current_A - shape["reference_A"])[:, None]
        courses = [("field", "T/A", current), ("quadratic", "T/A²", current**2)]
        if "time_constant_s" in shape:
            late = lagged(current, covariates.time_s, shape["time_constant_s"], covariates.memory)
            courses.append(("lagged", "T/A", current - late))
        terms = [
            term for name, unit, course in courses for term in course_terms(covariates, name, {name: unit}, course)
        ]
        along = covariates.field_T / covariates.intensity_T[:, None] * current
        return [*terms, scalar_term(covariates, "field", {f"field {axis}": "T/A" for axis in "xyz"}, along)]


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
        units = {f"turn about {axis} by weight along {other}": "rad" for axis in "xyz" for other in "xyz"}
        features = turned(covariates, covariates.field_T)[..., None] * upwards(covariates)[:, None, None, :]
        return sensor_terms(covariates, "turn", units, features.reshape(*features.shape[:2], 9))
