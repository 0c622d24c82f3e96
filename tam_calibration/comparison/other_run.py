"""An effect of one side in the run of the other: whether it would be seen there, and whether both are the same.

An effect that both sides have is taken off the recording with the simulation's parameters and with its own: what the
former leave beyond the latter, with the calibration fitted beside both, is the energy of the difference.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tam_calibration.comparison.causes import size_of
from tam_calibration.comparison.result import Side
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.evidence import unusable
from tam_calibration.gap.result import Cause
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect

_ALIKE = 0.2
"""Part of an effect by which its parameters may differ and still count as the same: twins of sensors differ so."""

_CERTAIN = 4.0
"""Energy of the difference of two fits of one effect, over that expected of their errors, from which they differ."""

_SAME_FREQUENCY = 0.01
"""Relative difference of two frequencies that are one: clocks and motors keep a per cent."""


def follows_the_run(name: str) -> bool:
    """Whether an effect adds what a run tells: it has neither chance nor times and phases of its own.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    effect = effect_named(name)
    if not isinstance(effect, LinearEffect):
        return False
    return not (effect.is_free_in_time or effect.surrogates == "at_other_frequencies")


def is_shown(fitted: FittedEffect, side: Side) -> bool:
    """Whether the run of a side could have shown an effect of the other.

    Parameters
    ----------
    fitted : FittedEffect
        Of the other side.
    side : Side
        Whose run it is.
    """
    effect, nominal = effect_named(fitted.effect), side.found.nominal
    channels = nominal.base().channels
    if unusable(effect, nominal.recording, channels.covariates) is not None:
        return False
    if not follows_the_run(fitted.effect):
        return True
    try:
        change = _energy_without(side, [fitted]) - _energy_without(side, [])
    except (InputError, Refused, np.linalg.LinAlgError):
        return False
    return change > channels.count * side.gap.smallest_gap**2


def _energy_without(side: Side, effects: Sequence[FittedEffect]) -> float:
    """Return the residual energy of a side once effects are taken off as they are, and the calibration fitted anew."""
    nominal = side.found.nominal
    return float(replace(nominal, recording=nominal.without(effects)).settled().base().energy)


def parameters_differ(
    theirs: Sequence[Cause], own: Sequence[Cause], simulation: Side, recording: Side
) -> tuple[float, bool]:
    """Return by which part of its energy an effect of both sides differs, and whether that is beyond chance.

    Parameters
    ----------
    theirs, own : sequence of Cause
        Of the simulation and of the recording: one each, or more where an effect that follows the run took several.
    simulation, recording : Side
        The two.
    """
    simulated, recorded = ([cause.fitted for cause in causes] for causes in (theirs, own))
    if follows_the_run(recorded[0].effect):
        part = _signals_apart(simulated, recorded, recording)
    else:
        part = _values_apart(simulated[0], recorded[0])
    count = sum(len(one.values) for fitted in recorded for one in fitted.contributions)
    energies = [
        sum(size_of(cause, side) ** 2 for cause in causes) * side.gap.channel_count
        for causes, side in ((theirs, simulation), (own, recording))
    ]
    chance = count * sum(1 / max(energy, 1.0) for energy in energies)
    return part, part > _ALIKE**2 + _CERTAIN * chance


def _signals_apart(theirs: Sequence[FittedEffect], own: Sequence[FittedEffect], recording: Side) -> float:
    """Return the energy that the simulation's parameters leave in the recording, over that of the effect."""
    try:
        with_theirs, with_own, without = (_energy_without(recording, one) for one in (theirs, own, []))
    except InputError:  # it lacks a channel that their form of the effect needs
        return 1.0
    return max(with_theirs - with_own, 0.0) / max(without - with_own, np.finfo(float).tiny)


def _values_apart(theirs: FittedEffect, own: FittedEffect) -> float:
    """Return the relative squared difference of the sizes at each place; 1 where the frequencies differ."""
    simulated, recorded = (one.shape.get("frequency_hz", 0.0) for one in (theirs, own))
    if abs(recorded - simulated) > _SAME_FREQUENCY * recorded:
        return 1.0
    if getattr(effect_named(own.effect), "is_of_site", False):
        return 0.0
    sizes = [_sizes_by_place(one) for one in (theirs, own)]
    places = sizes[0].keys() | sizes[1].keys()
    apart = sum((sizes[0].get(place, 0.0) - sizes[1].get(place, 0.0)) ** 2 for place in places)
    return apart / max(sum(size**2 for size in sizes[1].values()), np.finfo(float).tiny)


def _sizes_by_place(fitted: FittedEffect) -> dict[tuple[int, int | None], float]:
    sizes: dict[tuple[int, int | None], float] = {}
    for one in fitted.contributions:
        place = one.sensor, one.axis
        sizes[place] = float(np.hypot(sizes.get(place, 0.0), np.linalg.norm(list(one.values.values()))))
    return sizes
