"""Readings of one channel that bleed into another."""

from collections.abc import Mapping
from typing import ClassVar

import numpy as np

from tam_calibration.effects.effect import Coefficient, Limit, LinearEffect, Shape, Situation, Term
from tam_calibration.effects.motion import jumps
from tam_calibration.units import FloatArray

_PARALLEL = 0.9
"""Cosine of the angle between two axes above which what one bleeds into the other is a delay of that."""

_BLEED = Coefficient("bleed", "1")


class Crosstalk(LinearEffect):
    """An axis reads a part of what another channel read before it.

    A part of the present reading is inside the calibration; what a parallel axis bleeds is a delay of the axis itself.
    The noise that comes along is not modelled.
    """

    name: ClassVar[str] = "crosstalk"
    title: ClassVar[str] = "readings of another channel that bleed in"
    physics: ClassVar[str] = (
        "The capacitor of a converter keeps part of the charge of the channel that a multiplexer had connected before, "
        "and open switches and parallel wires let through part of another channel's signal while it is connected "
        "(Kester, The Data Conversion Handbook, Newnes, 2005, chapter 7)."
    )
    excitation: ClassVar[str] = "turn the array fast and about all axes, so that the channels differ and change"
    is_causal: ClassVar[bool] = False
    limits: ClassVar[Mapping[str, Limit]] = {
        "bleed": Limit(1.0, "an input that nothing drives keeps the whole charge of the one before it; Kester 2005")
    }

    def obstacle(self, situation: Situation) -> str | None:
        """Return that there is no continuous motion, where there is none."""
        return jumps(situation)

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return what each axis gets of each other channel's change since it was read before."""
        bled = _change(situation.sensed_T, situation)
        axes = situation.errors.matrix.reshape(-1, 3)
        axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        of_source = [np.ascontiguousarray(bled[:, [source]]) for source in range(situation.scalar_row)]
        return [
            Term.of_row(situation, row, f"previous {source // 3 + 1} {'xyz'[source % 3]}", [_BLEED], feature)
            for row in range(situation.scalar_row)
            for source, feature in enumerate(of_source)
            if abs(axes[source] @ axes[row]) < _PARALLEL
        ]


def _change(readings: FloatArray, situation: Situation) -> FloatArray:
    """Return the readings of the samples before less those of each (N, 3K); none behind a hole."""
    change = np.zeros_like(readings)
    for stretch in situation.stretches:
        change[stretch.start + 1 : stretch.stop] = -np.diff(readings[stretch], axis=0)
    return change
