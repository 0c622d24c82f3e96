"""Bias and scale factor that drift with temperature."""

from collections.abc import Iterable
from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import Coefficient, LinearEffect, Misfit, Shape, Situation, Term
from tam_calibration.effects.lag import lagged

_LEAST_CHANGE_K = 0.2
_SHORTEST, _LONGEST, _COUNT = 1 / 200, 1 / 3, 5
"""Time constants as parts of the record's span."""

_SLOWER = 6.0
"""Ratio of a second time constant to the first."""


class TemperatureDrift(LinearEffect):
    """Bias and scale factor of an axis follow the temperature, with a lag."""

    name: ClassVar[str] = "temperature_drift"
    title: ClassVar[str] = "bias and scale factor that drift with temperature"
    physics: ClassVar[str] = (
        "Core, coil and electronics of a magnetometer expand and change their magnetic properties with temperature, "
        "which they follow with a lag, so that offset and scale factor drift "
        "(Primdahl, Temperature compensation of fluxgate magnetometers, IEEE Trans. Magn. 6, 1970, p. 819)."
    )
    channels: ClassVar[tuple[str, ...]] = ("temperature_C",)
    excitation: ClassVar[str] = "let the temperature change by some kelvin, up and down, while the array turns"
    shape_units: ClassVar[dict[str, str]] = {"time_constant_s": "s", "reference_C": "°C"}

    def obstacle(self, situation: Situation) -> str | None:
        """Return that the temperature is constant, where it is."""
        assert situation.temperature_C is not None
        low, high = np.quantile(situation.temperature_C, (0.01, 0.99))
        if high - low < _LEAST_CHANGE_K:
            return f"the temperature changes by {high - low:.2g} K only"
        return None

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return lags from none to a third of the record."""
        assert situation.temperature_C is not None
        span = float(situation.time_s[-1] - situation.time_s[0])
        constants = [0.0, *np.geomspace(_SHORTEST * span, _LONGEST * span, _COUNT).tolist()]
        reference = float(np.mean(situation.temperature_C))
        return [{"time_constant_s": constant, "reference_C": reference} for constant in constants]

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return drifts of offset and scale, the second order of the offset, and the same with a slower lag."""
        assert situation.temperature_C is not None
        direct, time = situation.temperature_C - shape["reference_C"], situation.time_s
        constant = shape["time_constant_s"]
        change = lagged(direct, time, constant, situation.memory)
        parts = [("", change[:, None], change[:, None] ** 2)]
        if constant > 0:
            slower = lagged(direct, time, _SLOWER * constant, situation.memory)
            # As a difference, so that a single lag is told by its own time constant alone.
            parts.append(("slower ", (slower - change)[:, None], (slower**2 - change**2)[:, None]))
        terms = []
        for row in range(situation.scalar_row):
            for kind, first, second in parts:
                for name, unit, feature in (
                    ("offset", "T/K", first),
                    ("scale", "1/K", first * situation.sensed_T[:, [row]]),
                    ("quadratic offset", "T/K²", second),
                ):
                    part = Coefficient(kind + name, unit)
                    terms.append(Term.of_row(situation, row, part.name, [part], feature))
        return terms
