"""All effects that are installed, ours and those that other packages bring by an entry point, and their numbers."""

from collections.abc import Collection, Iterable
from functools import cache
from importlib.metadata import EntryPoint, entry_points

import numpy as np

from tam_calibration.effects.effect import CAUSES, Covariates, Effect, FittedEffect, LinearEffect
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.recording import is_further
from tam_calibration.model.sensor_errors import SensorErrors

GROUP = "tam_calibration.effects"
"""Entry points of other packages in this group name an ``Effect`` class each."""


@cache
def installed_effects() -> dict[str, Effect]:
    """Return the effects by name.

    Raises
    ------
    InputError
        When an entry point cannot be imported, or is no effect.
    """
    effects: dict[str, Effect] = {}
    own = {known["name"]: EntryPoint(known["name"], f"{__package__}.{place}", GROUP) for place, known in CAUSES.items()}
    others = {point.name: point for point in entry_points(group=GROUP)}
    for _, point in sorted((others | own).items()):
        try:
            effect = point.load()()
        except Exception as problem:  # the code of another package may raise anything when it is imported
            raise InputError(
                f"the effect {point.name} of {point.value} cannot be loaded ({problem}): repair or remove its package"
            ) from problem
        if not isinstance(effect, Effect) or effect.name != point.name:
            raise InputError(f"the entry point {point.name} = {point.value} is no effect of that name")
        effects[effect.name] = effect
    return effects


def effect_named(name: str) -> Effect:
    """Return an effect of the library.

    Raises
    ------
    InputError
        When there is none of that name.
    """
    effects = installed_effects()
    if name not in effects:
        raise InputError(f"there is no effect {quoted(name)}: choose one of {', '.join(effects)}")
    return effects[name]


def shown_by(effects: Collection[str]) -> set[str]:
    """Return the names of the faults of channels that some effects make, which are given by their names."""
    return {fault for name in effects for fault in effect_named(name).shows_as}


def units_of(fitted: FittedEffect, errors: SensorErrors, array: Array) -> dict[str, str]:
    """Return the SI unit of each coefficient and parameter of the shape, by name.

    Parameters
    ----------
    fitted : FittedEffect
        Its name and shape select the terms.
    errors : SensorErrors
        Calibration of the K sensors.
    array : Array
        Positions of the K sensors and of the scalar magnetometer.
    """
    effect = effect_named(fitted.effect)
    if not isinstance(effect, LinearEffect):
        return dict(effect.units)
    terms = effect.terms(_some_covariates(errors, array, effect.needs(fitted)), fitted.shape)
    return dict(effect.shape_units) | {part.name: part.unit for term in terms for part in term.coefficients}


def check_numbers(fitted: FittedEffect, errors: SensorErrors, array: Array) -> None:
    """Check that an effect has what its numbers are of.

    Parameters
    ----------
    fitted : FittedEffect
        Name, shape and contributions to check.
    errors : SensorErrors
        Calibration of the K sensors.
    array : Array
        Positions of the K sensors and of the scalar magnetometer.

    Raises
    ------
    InputError
        When there is no such effect, term or coefficient, or a parameter of the shape is missing.
    """
    effect = effect_named(fitted.effect)
    if isinstance(effect, LinearEffect):
        effect.signal(_some_covariates(errors, array, effect.needs(fitted)), fitted)


def _some_covariates(errors: SensorErrors, array: Array, channels: Iterable[str]) -> Covariates:
    """Return arbitrary covariates with all channels: names and units of coefficients do not depend on them."""
    time_s = np.arange(8.0)  # enough for the neighbours that effects need
    field = 5e-5 * np.column_stack([np.cos(time_s), np.sin(time_s), np.ones_like(time_s)])
    attitude = np.tile([0.0, 0.0, 0.0, 1.0], (len(time_s), 1))
    further = dict.fromkeys(filter(is_further, channels), time_s)
    return Covariates(time_s, field, errors, array, time_s, time_s, attitude, further=further)
