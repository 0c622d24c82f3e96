"""A sensor or axis that is sampled later than the others."""

from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import Coefficient, LinearEffect, Shape, Situation, Term
from tam_calibration.effects.motion import jumps, rates

_DELAY = Coefficient("delay", "s")
_SQUARE = Coefficient("delay squared", "s²")


class TimeSkew(LinearEffect):
    """What is read was sensed a delay before: b(t - δ) = b - δ db/dt + δ²/2 d²b/dt²; uses samples on both sides."""

    name: ClassVar[str] = "time_skew"
    title: ClassVar[str] = "sensor or axis that is sampled late"
    physics: ClassVar[str] = (
        "Converters that take their channels one after another, filters and transport delay a reading, so that in "
        "motion it is short of the field by the delay times its rate of change "
        "(Furgale, Rehder and Siegwart, Unified temporal and spatial calibration, IROS 2013)."
    )
    excitation: ClassVar[str] = "turn the array fast and continuously, not from pose to pose"
    is_causal: ClassVar[bool] = False

    def obstacle(self, situation: Situation) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(situation)

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return delays of a sensor, of a single axis and of the scalar magnetometer."""
        field_rate, field_curvature = rates(situation)
        matrix = situation.errors.matrix.reshape(-1, 3)
        late, curved = -field_rate @ matrix.T, field_curvature @ matrix.T / 2
        terms = []
        for sensor in range(situation.sensor_count):
            rows = np.arange(3 * sensor, 3 * sensor + 3)
            for name, coefficient, feature in (("delay", _DELAY, late), ("delay squared", _SQUARE, curved)):
                terms.append(Term(sensor, None, name, (coefficient,), feature[:, rows], rows, np.zeros(3, dtype=int)))
        for row in range(situation.scalar_row):
            terms.append(Term.of_row(situation, row, "delay of the axis", [_DELAY], late[:, row, None]))
        intensity_rate = np.sum(situation.field_T * field_rate, axis=1) / situation.intensity_T
        terms.append(Term.of_row(situation, situation.scalar_row, "delay", [_DELAY], -intensity_rate[:, None]))
        return terms
