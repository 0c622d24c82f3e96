"""What one side has and the other has not: effects, parameters and noise, each with its energy.

The energy of an effect is the part of the gap of its side that it explains, in squared noise floors.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from tam_calibration.comparison.agreement import (
    energy_of,
    follows_the_run,
    is_noise,
    is_shown,
    noise_differences,
    parameters_differ,
    rows_with,
)
from tam_calibration.comparison.result import UNKNOWN, EffectDifference, NoiseDifference, OtherParameters
from tam_calibration.comparison.side import Side
from tam_calibration.gap.result import Cause
from tam_calibration.model.exceptions import sensors_in_words

_OPEN = ("partly_explained", "unexplained")
"""Verdicts that leave an unknown part."""


def likely_causes(side: Side) -> list[Cause]:
    """Return the causes that are named: all where they explain the recording, else the likely ones.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    # Where an unknown part remains, a cause that is not likely belongs to it.
    return [cause for cause in side.gap.causes if side.gap.verdict not in _OPEN or cause.probability >= 0.5]


def unknown_part(side: Side) -> EffectDifference | None:
    """Return the part of a side that no effect explains, or only an unlikely one; None where nothing is open.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    gap = side.gap
    if gap.verdict not in _OPEN:
        return None
    energy = gap.size.before**2 - energy_of(likely_causes(side), side)
    probability = gap.probabilities.get("none_of_these", float("nan"))
    return EffectDifference(UNKNOWN, gap.where.sensors, gap.where.axes, probability, energy**0.5, True)


def may_be_same(one: EffectDifference, other: EffectDifference) -> bool:
    """Whether two unknown parts may be the same: they share a sensor, and are nearly of one size.

    Parameters
    ----------
    one, other : EffectDifference
        Both unknown.
    """
    small, large = sorted((one.size, other.size))
    # Runs of one phone, or one IMU, differ by half as much.
    return _share_sensors(one, other) and large - small <= 0.5 * large


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
    undecided : tuple of EffectDifference
        Unknown parts of simulation and recording that may be the same; empty where they are not, or there are none.
    """

    missing: tuple[EffectDifference, ...]
    surplus: tuple[EffectDifference, ...]
    other_parameters: tuple[OtherParameters, ...]
    noise: tuple[NoiseDifference, ...]
    energies: tuple[tuple[str, float], ...]
    undecided: tuple[EffectDifference, ...] = ()

    @property
    def energy(self) -> float:
        """The sum of the energies, squared noise floors."""
        return float(sum(energy for _, energy in self.energies))

    @property
    def undecided_energy(self) -> float:
        """What the unknown part of the recording adds to the energy if it is not that of the simulation."""
        return max((one.size**2 for one in self.undecided), default=0.0)

    @property
    def remarks(self) -> tuple[str, ...]:
        """What the two recordings leave open, in sentences."""
        if not self.undecided:
            return ()
        theirs, own = self.undecided
        sizes = f"{theirs.size:.2g} and {own.size:.2g} noise floors"
        return (f"Both have a part that no effect explains, of {sizes}: whether it is the same the two cannot tell.",)

    @property
    def that_show(self) -> "Differences":
        """The same without the effects that the simulation's run could not show if it had them."""
        hidden = {_missing_in_words(one) for one in self.missing if not one.is_shown_by_other_run}
        return replace(
            self,
            missing=tuple(one for one in self.missing if one.is_shown_by_other_run),
            energies=tuple(one for one in self.energies if one[0] not in hidden),
        )

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
    common, of_simulation_alone, of_recording_alone = _matched(simulation, recording)
    missing = _of_one_side(of_recording_alone, recording, simulation)
    surplus = _of_one_side(of_simulation_alone, simulation, recording)
    theirs, own = unknown_part(simulation), unknown_part(recording)
    in_both = set(rows_with(theirs)) & set(rows_with(own)) if theirs and own else set()
    undecided = (theirs, own) if theirs and own and may_be_same(theirs, own) else ()
    if not undecided:
        missing += [own] if own else []
        surplus += [theirs] if theirs else []
    energies = [(_missing_in_words(one), one.size**2) for one in missing]
    energies += [(_surplus_in_words(one), one.size**2) for one in surplus]
    other = []
    for of_simulation, of_recording in common:
        part, is_beyond = parameters_differ(of_simulation, of_recording, simulation, recording)
        if not is_beyond or is_noise(of_recording[0].fitted.effect):
            continue
        simulated = [_difference(cause, simulation, recording) for cause in of_simulation]
        recorded = [_difference(cause, recording, simulation) for cause in of_recording]
        other += [OtherParameters(*pair) for pair in zip(simulated, recorded, strict=False)]
        missing += recorded[len(simulated) :]
        surplus += simulated[len(recorded) :]
        energies.append((f"other parameters of {_named(recorded[0])}", part * energy_of(of_recording, recording)))
    if recording.gap.verdict == "explained":
        energies.append(("what the causes leave of the recording", recording.gap.size.after**2))
    noise = noise_differences(simulation, recording, in_both)
    counted = {
        row for one in (*missing, *surplus) if one.fitted is None or is_noise(one.effect) for row in rows_with(one)
    }
    energies += _noise_energies(noise, counted)
    return Differences(
        tuple(sorted(missing, key=lambda one: -one.size)),
        tuple(sorted(surplus, key=lambda one: -one.size)),
        tuple(other),
        noise,
        tuple(sorted(energies, key=lambda one: -one[1])),
        undecided,
    )


def _of_one_side(causes: Sequence[Cause], side: Side, other: Side) -> list[EffectDifference]:
    """Return the causes that only one side has; more noise of all sensors only means that the data sheet is wrong."""
    return [
        _difference(cause, side, other)
        for cause in causes
        if not (is_noise(cause.fitted.effect) and len(set(cause.sensors) - {"scalar"}) == side.array.sensor_count)
    ]


def _difference(cause: Cause, side: Side, other: Side) -> EffectDifference:
    return EffectDifference(
        cause.fitted.effect,
        cause.sensors,
        cause.axes,
        cause.probability,
        energy_of([cause], side) ** 0.5,
        is_shown(cause.fitted, other),
        cause.fitted,
        cause.units,
    )


def _named(one: EffectDifference) -> str:
    """Return an effect with its place, in words."""
    name = "an unknown part" if one.effect == UNKNOWN else one.effect.replace("_", " ")
    return f"{name} ({sensors_in_words(one.sensors, axes=one.axes)})"


def _missing_in_words(one: EffectDifference) -> str:
    if one.effect == UNKNOWN:
        return f"{_named(one)} in the recording"
    unless = "" if one.is_shown_by_other_run else " or its run could not show"
    return f"{_named(one)}, which the simulation lacks{unless}"


def _surplus_in_words(one: EffectDifference) -> str:
    return f"{_named(one)} in the simulation" if one.effect == UNKNOWN else f"{_named(one)}, which the recording lacks"


def _matched(
    simulation: Side, recording: Side
) -> tuple[list[tuple[list[Cause], list[Cause]]], list[Cause], list[Cause]]:
    """Return the causes that both sides have, in groups of one effect, and those of one side alone."""
    left, common, own = likely_causes(simulation), [], []
    for causes in _grouped(likely_causes(recording)):
        same = [one for one in left if any(_is_same_cause(one, cause) for cause in causes)]
        best = max(same, key=lambda one: (one.fitted.effect == causes[0].fitted.effect, one.share), default=None)
        if best is None:
            own += causes
            continue
        theirs = next(group for group in _grouped(same) if best in group)
        left = [one for one in left if one not in theirs]
        common.append((theirs, causes))
    return common, left, own


def _grouped(causes: Sequence[Cause]) -> list[list[Cause]]:
    """Return causes by effect: several of one that follows the run, at common sensors, are one effect in two shapes."""
    groups: list[list[Cause]] = []
    for cause in causes:
        name = cause.fitted.effect
        known = [
            group
            for group in groups
            if group[0].fitted.effect == name and any(_share_sensors(cause, one) for one in group)
        ]
        if known and follows_the_run(name):
            known[0].append(cause)
        else:
            groups.append([cause])
    return groups


def _share_sensors(one: Cause | EffectDifference, other: Cause | EffectDifference) -> bool:
    return not set(one.sensors).isdisjoint(other.sensors)


def _is_same_cause(one: Cause, other: Cause) -> bool:
    """Whether two causes share a sensor, and have the same name or names that data do not separate."""
    first, second = one.fitted.effect, other.fitted.effect
    is_one_name = first == second or first in other.indistinguishable_from or second in one.indistinguishable_from
    return is_one_name and _share_sensors(one, other)


def _noise_energies(noise: Sequence[NoiseDifference], counted: Collection[tuple[int, str]]) -> list[tuple[str, float]]:
    """Return the energy of other noise: of the noisier side beyond the other, in its floors, the mean of all axes.

    That of axes with an unknown part counts as this part.
    """
    others = [one for one in noise if one.differs and (one.recording.sensor, one.recording.axis) not in counted]
    if not others:
        return []
    levels = [sorted((one.simulation.level_T, one.recording.level_T)) for one in others]
    energy = sum((large / small) ** 2 - 1 for small, large in levels) / len(noise)
    sensors = dict.fromkeys(one.recording.sensor or "scalar" for one in others)
    return [(f"other noise ({sensors_in_words(tuple(sensors))})", energy)]
