"""Whether two runs show the same effect: what the other run could have shown, and parameters that agree.

An effect that both sides have is removed from the recording with the simulation's parameters and with its own. What the
former leave beyond the latter, with the calibration fitted again, is the energy of the difference.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tam_calibration.comparison.result import Side
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.laws.law import CAUSES
from tam_calibration.gap.result import Cause
from tam_calibration.gap.size import unusable
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect


def energy_of(causes: Sequence[Cause], side: Side) -> float:
    """Return the energy that causes explain, squared noise floors of the side that was diagnosed.

    Parameters
    ----------
    causes : sequence of Cause
        Of the diagnosis of the side.
    side : Side
        That was diagnosed.
    """
    size = side.gap.size
    return sum(max(cause.share * (size.before**2 - size.after**2), 0.0) for cause in causes)


def follows_the_run(name: str) -> bool:
    """Whether an effect follows what is recorded: it is not random, and has no times or phases of its own.

    Parameters
    ----------
    name : str
        Of the effect.
    """
    effect = effect_named(name)
    has_phase = any("tone" in one.course for one in CAUSES if one.name == name)
    return isinstance(effect, LinearEffect) and not (effect.is_free_in_time or has_phase)


def is_shown(fitted: FittedEffect, side: Side) -> bool:
    """Whether the run of a side could have shown an effect of the other side.

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
    """Return the residual energy of a side after effects are removed and the calibration is fitted again."""
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
        part = _difference_of_signals(simulated, recorded, recording)
    else:
        part = _difference_of_values(simulated[0], recorded[0])
    count = sum(len(one.values) for fitted in recorded for one in fitted.contributions)
    chance = sum(
        count / max(energy_of(causes, side) * side.gap.channel_count, 1.0)
        for causes, side in ((theirs, simulation), (own, recording))
    )
    # Twins of sensors differ by a fifth; beyond that, four times what the errors of the two fits explain is no chance.
    return part, part > 0.2**2 + 4.0 * chance


def _difference_of_signals(theirs: Sequence[FittedEffect], own: Sequence[FittedEffect], recording: Side) -> float:
    """Return the energy that the simulation's parameters leave in the recording, over that of the effect."""
    try:
        with_theirs, with_own, without = (_energy_without(recording, one) for one in (theirs, own, []))
    except InputError:  # it lacks a channel that their form of the effect needs
        return 1.0
    return max(with_theirs - with_own, 0.0) / max(without - with_own, np.finfo(float).tiny)


def _difference_of_values(theirs: FittedEffect, own: FittedEffect) -> float:
    """Return the relative squared difference of the sizes at each place; 1 where the frequencies differ."""
    simulated, recorded = (one.shape.get("frequency_hz", 0.0) for one in (theirs, own))
    # Clocks and motors keep a per cent.
    if abs(recorded - simulated) > 0.01 * recorded:
        return 1.0
    if getattr(effect_named(own.effect), "is_of_site", False):
        return 0.0
    places = {(one.sensor, one.axis) for fitted in (theirs, own) for one in fitted.contributions}
    sizes = np.array([[_size_at(place, fitted) for place in places] for fitted in (theirs, own)])
    return float(np.sum((sizes[0] - sizes[1]) ** 2) / max(np.sum(sizes[1] ** 2), np.finfo(float).tiny))


def _size_at(place: tuple[int, int | None], fitted: FittedEffect) -> float:
    values = [v for one in fitted.contributions if (one.sensor, one.axis) == place for v in one.values.values()]
    return float(np.linalg.norm(values))
