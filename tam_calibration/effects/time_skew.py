"""A sensor or axis that is sampled later than the others."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import Coefficient, Limit, LinearEffect, Shape, Situation, Term
from tam_calibration.effects.motion import jumps, rates

_DELAY = Coefficient("delay", "s")


class TimeSkew(LinearEffect):
    """What is read was sensed a delay before: b(t - δ) = b - δ db/dt; uses samples on both sides."""

    name: ClassVar[str] = "time_skew"
    title: ClassVar[str] = "sensor or axis that is sampled late"
    physics: ClassVar[str] = (
        "Converters that take their channels one after another, filters and transport delay a reading, so that in "
        "motion it is short of the field by the delay times its rate of change "
        "(Furgale, Rehder and Siegwart, Unified temporal and spatial calibration, IROS 2013)."
    )
    excitation: ClassVar[str] = "turn the array fast and continuously, not from pose to pose"
    is_causal: ClassVar[bool] = False
    within: ClassVar[tuple[str, ...]] = ("eddy_current", "ringing", "crosstalk")
    limits: ClassVar[Mapping[str, Limit]] = {
        "delay": Limit(
            1.0,
            "filters, buses and wireless links delay a sensor by milliseconds to some tenths of a second; Furgale, "
            "Rehder and Siegwart 2013",
            "s",
        )
    }

    def obstacle(self, situation: Situation) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(situation)

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return delays of a sensor, of a single axis and of the scalar magnetometer."""
        field_rate = rates(situation)
        late = -field_rate @ situation.errors.matrix.reshape(-1, 3).T
        terms = []
        for sensor in range(situation.sensor_count):
            rows = np.arange(3 * sensor, 3 * sensor + 3)
            terms.append(Term(sensor, None, "delay", (_DELAY,), late[:, rows], rows, np.zeros(3, dtype=int)))
        for row in range(situation.scalar_row):
            terms.append(Term.of_row(situation, row, "delay of the axis", [_DELAY], late[:, row, None]))
        intensity_rate = np.sum(situation.field_T * field_rate, axis=1) / situation.intensity_T
        terms.append(Term.of_row(situation, situation.scalar_row, "delay", [_DELAY], -intensity_rate[:, None]))
        return terms
