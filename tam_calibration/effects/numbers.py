"""An effect's numbers: their SI units, and whether they are numbers of that effect."""

import numpy as np

from tam_calibration.array import Array
from tam_calibration.effects.effect import FittedEffect, LinearEffect, Situation
from tam_calibration.effects.library import effect_named
from tam_calibration.sensor_errors import SensorErrors

_SAMPLES = 8
"""Samples of any situation; as many as every effect has neighbours for."""

_FIELD_T = 5e-5
"""Tesla; a field of usual size, of which names and units do not depend."""


def units_of(fitted: FittedEffect, errors: SensorErrors, array: Array) -> dict[str, str]:
    """Return the SI unit of each coefficient and parameter of the shape, by name."""
    effect = effect_named(fitted.effect)
    if not isinstance(effect, LinearEffect):
        units: dict[str, str] = dict(getattr(effect, "units", {}))
        return units
    terms = effect.terms(_some_situation(errors, array), fitted.shape)
    return dict(effect.shape_units) | {part.name: part.unit for term in terms for part in term.coefficients}


def check_numbers(fitted: FittedEffect, errors: SensorErrors, array: Array) -> None:
    """Check that an effect has what its numbers are of.

    Raises
    ------
    InputError
        When there is no such effect, term or coefficient, or a parameter of the shape is missing.
    """
    effect = effect_named(fitted.effect)
    if isinstance(effect, LinearEffect):
        effect.signal(_some_situation(errors, array), fitted)


def _some_situation(errors: SensorErrors, array: Array) -> Situation:
    """Return any situation with all channels: the names and units of coefficients are the same in all."""
    time_s = np.arange(float(_SAMPLES))
    field = _FIELD_T * np.column_stack([np.cos(time_s), np.sin(time_s), np.ones(_SAMPLES)])
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (_SAMPLES, 1))
    return Situation(time_s, field, errors, array, time_s, time_s, attitude)
