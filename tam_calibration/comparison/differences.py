"""What one side has and the other has not: effects, parameters and noise, each with its energy.

The energy of an effect is the part of the gap of its side that it explains, in squared noise floors. An effect that
both sides have is taken off the recording with the simulation's parameters and with its own: what the former leave
beyond the latter, with the calibration fitted beside both, is the energy of the difference.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.comparison.noise import differs
from tam_calibration.comparison.result import (
    UNKNOWN,
    EffectDifference,
    NoiseDifference,
    OtherParameters,
    Side,
)
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

_OPEN = ("partly_explained", "unexplained")
"""Verdicts that leave an unknown part."""


@dataclass(frozen=True, eq=False)
class Differences:
    """What a simulation and a recording have otherwise.

    Parameters
    ----------
    missing, surplus : tuple of EffectDifference
        Of the recording alone, and of the simulation alone; the largest first.
    other_parameters : tuple of OtherParameters
        Of both, with other parameters.
    noise : tuple of NoiseDifference
        Of each axis, and the scalar.
    energies : tuple of (str, float)
        What each difference is, in words, and its energy in squared noise floors; the largest first.
    """

    missing: tuple[EffectDifference, ...]
    surplus: tuple[EffectDifference, ...]
    other_parameters: tuple[OtherParameters, ...]
    noise: tuple[NoiseDifference, ...]
    energies: tuple[tuple[str, float], ...]

    @property
    def energy(self) -> float:
        """The sum of the energies, squared noise floors."""
        return float(sum(energy for _, energy in self.energies))

    @property
    def are_none(self) -> bool:
        """Whether the sides have all in common."""
        return not (self.missing or self.surplus or self.other_parameters or any(one.differs for one in self.noise))


def differences_between(simulation: Side, recording: Side) -> Differences:
    """Return what a simulation and a recording have otherwise.

    Parameters
    ----------
    simulation, recording : Side
        Of the same number of sensors.
    """
    common, of_simulation, of_recording = _matched(simulation, recording)
    missing = [
        _difference(cause, recording, simulation) for cause in of_recording if not _is_all_noise(cause, recording)
    ]
    surplus = [
        _difference(cause, simulation, recording) for cause in of_simulation if not _is_all_noise(cause, simulation)
    ]
    energies = [(f"{_named(one)}, which the simulation lacks", one.size**2) for one in missing]
    energies += [(f"{_named(one)}, which the recording lacks", one.size**2) for one in surplus]
    other = []
    for theirs, own in common:
        part, is_beyond = _parameters_differ(theirs, own, simulation, recording)
        if is_beyond and not is_noise(own.fitted.effect):
            pair = OtherParameters(_difference(theirs, simulation, recording), _difference(own, recording, simulation))
            other.append(pair)
            energies.append((f"other parameters of {_named(pair.recording)}", part * pair.recording.size**2))
    open_here, open_there = _unknown(recording), _unknown(simulation)
    if open_here is not None and not _is_like(open_here, open_there):
        missing.append(open_here)
        energies.append((f"{_named(open_here)} in the recording", open_here.size**2))
    if open_there is not None and not _is_like(open_there, open_here):
        surplus.append(open_there)
        energies.append((f"{_named(open_there)} in the simulation", open_there.size**2))
    if recording.gap.verdict == "explained":
        energies.append(("what the causes leave of the recording", recording.gap.size.after**2))
    noise = _noise(simulation, recording)
    told = {place for one in (*missing, *surplus) if one.fitted is None or is_noise(one.effect) for place in _rows(one)}
    energies += _noise_energies(noise, told)
    return Differences(
        _ranked(missing),
        _ranked(surplus),
        tuple(other),
        noise,
        tuple(sorted(energies, key=lambda one: -one[1])),
    )


def is_noise(effect: str) -> bool:
    """Whether an effect is more noise of some axes, which the noise of each axis tells too.

    Parameters
    ----------
    effect : str
        Its name, or ``UNKNOWN``.
    """
    return effect != UNKNOWN and effect_named(effect).explains_any_excess


def _is_all_noise(cause: Cause, side: Side) -> bool:
    """Whether a cause is more noise of all sensors: the sheet is wrong, or the simulator's noise."""
    return is_noise(cause.fitted.effect) and len(set(cause.sensors) - {"scalar"}) == side.array.sensor_count


def _ranked(found: Sequence[EffectDifference]) -> tuple[EffectDifference, ...]:
    return tuple(sorted(found, key=lambda one: -one.size))


def _named(one: EffectDifference) -> str:
    return "an unknown part" if one.effect == UNKNOWN else one.effect.replace("_", " ")


def _matched(simulation: Side, recording: Side) -> tuple[list[tuple[Cause, Cause]], list[Cause], list[Cause]]:
    """Return the causes that both sides have, in pairs, and those of the simulation and of the recording alone."""
    left, common, own = list(simulation.gap.causes), [], []
    for cause in recording.gap.causes:
        alike = [one for one in left if _is_same_cause(one, cause)]
        best = max(alike, key=lambda one: (one.fitted.effect == cause.fitted.effect, one.share), default=None)
        if best is None:
            own.append(cause)
        else:
            left.remove(best)
            common.append((best, cause))
    return common, left, own


def _is_same_cause(one: Cause, other: Cause) -> bool:
    """Whether two causes have the same name, or names that data do not tell apart, and a place in common."""
    names = one.fitted.effect, other.fitted.effect
    is_one_name = names[0] == names[1] or names[0] in other.indistinguishable_from
    is_one_name |= names[1] in one.indistinguishable_from
    return is_one_name and bool(set(one.sensors) & set(other.sensors))


def _size(cause: Cause, side: Side) -> float:
    """Return the root of the energy that a cause explains, in noise floors."""
    size = side.gap.size
    return float(np.sqrt(max(cause.share * (size.before**2 - size.after**2), 0.0)))


def _difference(cause: Cause, side: Side, other: Side) -> EffectDifference:
    return EffectDifference(
        cause.fitted.effect,
        cause.sensors,
        cause.axes,
        cause.probability,
        _size(cause, side),
        _is_shown(cause.fitted, other),
        cause.fitted,
        cause.units,
    )


def _unknown(side: Side) -> EffectDifference | None:
    """Return what no effect explains of a side; None where nothing is open."""
    gap = side.gap
    if gap.verdict not in _OPEN:
        return None
    size = gap.size.before if gap.verdict == "unexplained" else gap.size.after
    probability = gap.probabilities.get("none_of_these", float("nan"))
    return EffectDifference(UNKNOWN, gap.where.sensors, gap.where.axes, probability, size, True)


def _is_like(one: EffectDifference, other: EffectDifference | None) -> bool:
    """Whether two unknown parts may be the same: of one place, and nearly of one size."""
    if other is None or not set(one.sensors) & set(other.sensors):
        return False
    small, large = sorted((one.size, other.size))
    return large - small <= _ALIKE * large


def _is_of_clock(effect: LinearEffect) -> bool:
    """Whether an effect has times or phases of its own, which another run does not repeat."""
    return effect.is_free_in_time or effect.surrogates == "at_other_frequencies"


def _is_shown(fitted: FittedEffect, side: Side) -> bool:
    """Whether the run of a side could have shown an effect of the other."""
    effect, nominal = effect_named(fitted.effect), side.found.nominal
    channels = side.found.nominal.base().channels
    if unusable(effect, nominal.recording, channels.covariates) is not None:
        return False
    if not isinstance(effect, LinearEffect) or _is_of_clock(effect):
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


def _parameters_differ(theirs: Cause, own: Cause, simulation: Side, recording: Side) -> tuple[float, bool]:
    """Return by which part of its energy an effect of both sides differs, and whether that is beyond chance."""
    effect = effect_named(own.fitted.effect)
    if not isinstance(effect, LinearEffect) or _is_of_clock(effect):
        part = _values_apart(theirs.fitted, own.fitted)
    else:
        part = _signals_apart(theirs.fitted, own.fitted, recording)
    count = sum(len(one.values) for one in own.fitted.contributions)
    energies = [
        _size(cause, side) ** 2 * side.gap.channel_count for cause, side in ((theirs, simulation), (own, recording))
    ]
    chance = count * sum(1 / max(energy, 1.0) for energy in energies)
    return part, part > _ALIKE**2 + _CERTAIN * chance


def _signals_apart(theirs: FittedEffect, own: FittedEffect, recording: Side) -> float:
    """Return the energy that the simulation's parameters leave in the recording, over that of the effect."""
    try:
        with_theirs, with_own, without = (_energy_without(recording, one) for one in ([theirs], [own], []))
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


def _noise(simulation: Side, recording: Side) -> tuple[NoiseDifference, ...]:
    """Return the noise of every axis of both sides; where a known effect stays in it, no difference is told."""
    causes = [*simulation.gap.causes, *recording.gap.causes]
    staying = {place for cause in causes if _stays(cause.fitted.effect) for place in _rows(cause)}
    theirs = {(one.sensor, one.axis): one for one in simulation.noise}
    return tuple(
        NoiseDifference(
            theirs[own.sensor, own.axis],
            own,
            (own.sensor, own.axis) not in staying and differs(theirs[own.sensor, own.axis], own),
        )
        for own in recording.noise
        if (own.sensor, own.axis) in theirs
    )


def _stays(effect: str) -> bool:
    """Whether an effect is in the residual of which the noise is taken, as it cannot be taken off."""
    return not is_noise(effect) and not isinstance(effect_named(effect), LinearEffect)


def _rows(one: Cause | EffectDifference) -> list[tuple[int, str]]:
    return [
        (0, "") if sensor == "scalar" else (int(sensor), axis)
        for sensor in one.sensors
        for axis in (("",) if sensor == "scalar" else one.axes or "xyz")
    ]


def _noise_energies(noise: Sequence[NoiseDifference], told: Collection[tuple[int, str]]) -> list[tuple[str, float]]:
    """Return the energy of other noise: of the noisier side beyond the other, in its floors, the mean of all axes.

    That of axes with an unknown part counts as this part.
    """
    energy = 0.0
    for one in noise:
        if one.differs and (one.recording.sensor, one.recording.axis) not in told:
            small, large = sorted((one.simulation.level_T, one.recording.level_T))
            energy += ((large / small) ** 2 - 1) / len(noise)
    return [("other noise", energy)] if energy > 0 else []
