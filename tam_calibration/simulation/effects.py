"""Effects in a simulated recording: what each adds, in a fixed order.

Effects that add to the rows act on the field and the sensor, in front of the noise. The others act on readings with
noise: first those that strike them, in the order of the scenario, then the end of the range, then the steps.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from tam_calibration.effects.effect import Effect, FittedEffect, LinearEffect, Situation
from tam_calibration.effects.library import effect_named
from tam_calibration.exceptions import InputError
from tam_calibration.units import FloatArray

LAST = ("saturation", "quantization")
"""What ends the way of a reading, in this order."""

_CHANNELS = {"temperature_C": "temperature", "current_A": "current"}


def add_effects(
    rows_T: FloatArray,
    situation: Situation,
    effects: Sequence[FittedEffect],
    generators: Sequence[np.random.Generator],
    stage: Literal["field", "reading"],
) -> FloatArray:
    """Return the rows (N, 3K + 1) with the effects of a stage in them, tesla.

    Parameters
    ----------
    rows_T : (N, 3K + 1) array
        Without noise for the stage "field", with it for "reading".
    situation : Situation
        The truth.
    effects : sequence of FittedEffect
        All effects of the scenario.
    generators : sequence of numpy.random.Generator
        One for each of them.
    stage : str
        "field" or "reading".

    Raises
    ------
    InputError
        When an effect is not known, needs a channel that the scenario has not, or has no such sensor, term or value.
    """
    for index in sorted(range(len(effects)), key=lambda index: _place(effects[index].effect)):
        fitted, generator = effects[index], generators[index]
        effect = effect_named(fitted.effect)
        if isinstance(effect, LinearEffect) != (stage == "field"):
            continue
        try:
            _check(effect, fitted, situation)
            rows_T = effect.add(rows_T, situation, fitted, generator)
        except KeyError as missing:
            raise InputError(f"the effect {fitted.effect} needs the value {missing}") from None
    return rows_T


def _place(name: str) -> int:
    return LAST.index(name) if name in LAST else -1


def _check(effect: Effect, fitted: FittedEffect, situation: Situation) -> None:
    for channel, key in _CHANNELS.items():
        if channel in effect.channels and getattr(situation, channel) is None:
            raise InputError(f"the effect {effect.name} follows the {key}: add {key} to the scenario")
    for part in fitted.contributions:
        if part.sensor >= situation.sensor_count:
            raise InputError(
                f"the effect {effect.name} acts on sensor {part.sensor + 1}, and there are {situation.sensor_count}"
            )
