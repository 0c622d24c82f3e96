"""Readings of one channel that bleed into another."""

from collections.abc import Iterable, Mapping
from typing import ClassVar

import numpy as np

from tam_calibration.effects.change_points import LEAST_SAMPLES
from tam_calibration.effects.effect import Coefficient, Limit, LinearEffect, Misfit, Shape, Situation, Term
from tam_calibration.effects.motion import jumps
from tam_calibration.effects.switching import WINDOW_UNITS, Level, in_windows
from tam_calibration.units import FloatArray

_ROWS = 3
"""Axes, those with the most energy, in which windows are sought."""

_STARTS = 2
"""Of these and the directions of the field, those that explain most, of which the windows are settled."""

_PARALLEL = 0.9
"""Cosine of the angle between two axes above which what one bleeds into the other is a delay or a gain of that."""

_BLEED = Coefficient("bleed", "1")


class Crosstalk(LinearEffect):
    """An axis reads a part of another channel's previous reading, or of its present one while a multiplexer is busy.

    A constant part of the present reading is inside the calibration; what a parallel axis bleeds is a delay of the axis
    itself, or a gain that is switched. The noise that comes along is not modelled.
    """

    name: ClassVar[str] = "crosstalk"
    title: ClassVar[str] = "readings of another channel that bleed in"
    physics: ClassVar[str] = (
        "The capacitor of a converter keeps part of the charge of the channel that a multiplexer had connected before, "
        "and open switches and parallel wires let through part of another channel's signal while it is connected "
        "(Kester, The Data Conversion Handbook, Newnes, 2005, chapter 7)."
    )
    excitation: ClassVar[str] = "turn the array fast and about all axes, so that the channels differ and change"
    is_free_in_time: ClassVar[bool] = True
    is_causal: ClassVar[bool] = False
    has_exact_shapes: ClassVar[bool] = True
    shape_units: ClassVar[Mapping[str, str]] = WINDOW_UNITS
    limits: ClassVar[Mapping[str, Limit]] = {
        "bleed": Limit(1.0, "an input that nothing drives keeps the whole charge of the one before it; Kester 2005")
    }

    def obstacle(self, situation: Situation) -> str | None:
        """Return that the recording is too short, where it is."""
        if situation.sample_count < LEAST_SAMPLES:
            return f"{situation.sample_count} samples are too few to tell one channel from another"
        return None

    def shapes(self, situation: Situation, misfit: Misfit) -> Iterable[Shape]:
        """Return the bleed of previous readings, and the windows in which a present one explains most."""
        if situation.sample_count < LEAST_SAMPLES:
            return []
        energy = np.sum(misfit.row_shift_T**2 * misfit.row_information, axis=0)[: situation.scalar_row]
        levels = [
            Level.of_row(misfit, row, along)
            for row in np.argsort(-energy)[:_ROWS].tolist()
            for along in situation.field_T.T
        ]
        started = sorted(((level.start(), level) for level in levels), key=lambda one: -one[0].gain)[:_STARTS]
        states, level = max(((level.settled(start), level) for start, level in started), key=lambda one: one[0].gain)
        windows = [states.shape(situation)] if level.is_switching(states) else []
        return [*([] if jumps(situation) else [{}]), *windows]

    def terms(self, situation: Situation, shape: Shape) -> list[Term]:
        """Return what each axis gets of each other channel: of its change since it was read before, or in windows."""
        readings = situation.sensed_T + situation.errors.bias_T.ravel()
        name, bled = "previous", _change(readings, situation)
        if shape:
            name, bled = "busy", np.where(in_windows(situation, shape)[:, None], readings, 0.0)
        axes = situation.errors.matrix.reshape(-1, 3)
        axes = axes / np.linalg.norm(axes, axis=1)[:, None]
        of_source = [np.ascontiguousarray(bled[:, [source]]) for source in range(situation.scalar_row)]
        return [
            Term.of_row(situation, row, f"{name} {source // 3 + 1} {'xyz'[source % 3]}", [_BLEED], feature)
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
