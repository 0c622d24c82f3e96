"""All effects that are installed: ours, and those that other packages bring by an entry point."""

from functools import cache
from importlib.metadata import entry_points

from tam_calibration.effects.effect import Effect
from tam_calibration.exceptions import InputError

GROUP = "tam_calibration.effects"
"""Entry points of this group name an ``Effect`` class each."""


@cache
def installed_effects() -> dict[str, Effect]:
    """Return the effects by name.

    Raises
    ------
    InputError
        When an entry point cannot be imported, or is no effect.
    """
    effects: dict[str, Effect] = {}
    for point in sorted(entry_points(group=GROUP), key=lambda point: point.name):
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
        raise InputError(f"there is no effect {name!r}: choose one of {', '.join(effects)}")
    return effects[name]
