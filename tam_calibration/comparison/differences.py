"""What one side has and the other has not: effects, parameters and noise, each with its energy.

The energy of an effect is the part of the gap of its side that it explains, in squared noise floors.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from tam_calibration.comparison.causes import are_alike, likely_causes, size_of, unknown_part
from tam_calibration.comparison.mistakes.words import numbered
from tam_calibration.comparison.noise import differs
from tam_calibration.comparison.other_run import follows_the_run, is_shown, parameters_differ
from tam_calibration.comparison.result import (
    UNKNOWN,
    EffectDifference,
    NoiseDifference,
    OtherParameters,
    Side,
)
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.result import Cause


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
        """What nobody can tell of the two, in sentences."""
        if not self.undecided:
            return ()
        theirs, own = self.undecided
        sizes = f"{theirs.size:.2g} and {own.size:.2g} noise floors"
        return (f"Both have a part that no effect explains, of {sizes}: whether it is the same the two cannot tell.",)

    @property
    def that_show(self) -> "Differences":
        """The same without the effects that the simulation's run could not show if it had them."""
        hidden = [one for one in self.missing if not one.is_shown_by_other_run]
        words = {_lacking(one) for one in hidden}
        return replace(
            self,
            missing=tuple(one for one in self.missing if one not in hidden),
            energies=tuple(one for one in self.energies if one[0] not in words),
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
    missing = [
        _difference(cause, recording, simulation) for cause in of_recording_alone if not _is_all_noise(cause, recording)
    ]
    surplus = [
        _difference(cause, simulation, recording)
        for cause in of_simulation_alone
        if not _is_all_noise(cause, simulation)
    ]
    energies = [(_lacking(one), one.size**2) for one in missing]
    energies += [(f"{_named(one)}, which the recording lacks", one.size**2) for one in surplus]
    other = []
    for theirs, own in common:
        part, is_beyond = parameters_differ(theirs, own, simulation, recording)
        if is_beyond and not is_noise(own[0].fitted.effect):
            differing = [_difference(cause, recording, simulation) for cause in own]
            of_simulation = [_difference(cause, simulation, recording) for cause in theirs]
            other += [OtherParameters(*pair) for pair in zip(of_simulation, differing, strict=False)]
            missing += differing[len(theirs) :]
            surplus += of_simulation[len(own) :]
            energy = sum(one.size**2 for one in differing)
            energies.append((f"other parameters of {_named(differing[0])}", part * energy))
    open_here, open_there = unknown_part(recording), unknown_part(simulation)
    in_both = _places(open_here) & _places(open_there)
    undecided: tuple[EffectDifference, ...] = ()
    if open_here is not None and open_there is not None and are_alike(open_there, open_here):
        undecided, open_here, open_there = (open_there, open_here), None, None
    if open_here is not None:
        missing.append(open_here)
        energies.append((f"{_named(open_here)} in the recording", open_here.size**2))
    if open_there is not None:
        surplus.append(open_there)
        energies.append((f"{_named(open_there)} in the simulation", open_there.size**2))
    if recording.gap.verdict == "explained":
        energies.append(("what the causes leave of the recording", recording.gap.size.after**2))
    noise = _noise(simulation, recording, in_both)
    told = {place for one in (*missing, *surplus) if one.fitted is None or is_noise(one.effect) for place in _rows(one)}
    energies += _noise_energies(noise, told)
    return Differences(
        _ranked(missing),
        _ranked(surplus),
        tuple(other),
        noise,
        tuple(sorted(energies, key=lambda one: -one[1])),
        undecided,
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
    """Return an effect with its place, in words."""
    name = "an unknown part" if one.effect == UNKNOWN else one.effect.replace("_", " ")
    return f"{name} ({_place(one.sensors, one.axes)})"


def _place(sensors: Sequence[int | str], axes: Sequence[str] = ()) -> str:
    """Return sensors and, where they are not all, axes in words."""
    numbers = [sensor for sensor in sensors if isinstance(sensor, int)]
    some_axes = f" {', '.join(axes)}" if 0 < len(axes) < 3 else ""
    places = [numbered(numbers) + some_axes] if numbers else []
    return " and ".join([*places, *(["the scalar"] if "scalar" in sensors else [])])


def _lacking(one: EffectDifference) -> str:
    unless = "" if one.is_shown_by_other_run else " or its run could not show"
    return f"{_named(one)}, which the simulation lacks{unless}"


def _matched(
    simulation: Side, recording: Side
) -> tuple[list[tuple[list[Cause], list[Cause]]], list[Cause], list[Cause]]:
    """Return the causes that both sides have, in groups of one effect, and those of one side alone."""
    left, common, own = likely_causes(simulation), [], []
    for causes in _grouped(likely_causes(recording)):
        alike = [one for one in left if any(_is_same_cause(one, cause) for cause in causes)]
        best = max(alike, key=lambda one: (one.fitted.effect == causes[0].fitted.effect, one.share), default=None)
        if best is None:
            own += causes
            continue
        theirs = next(group for group in _grouped(alike) if best in group)
        left = [one for one in left if one not in theirs]
        common.append((theirs, causes))
    return common, left, own


def _grouped(causes: Sequence[Cause]) -> list[list[Cause]]:
    """Return causes by effect: several of one that follows the run, at common sensors, are one effect in two shapes."""
    groups: list[list[Cause]] = []
    for cause in causes:
        name = cause.fitted.effect
        of_name = (group for group in groups if group[0].fitted.effect == name and follows_the_run(name))
        known = next((group for group in of_name if any(_share_sensors(cause, one) for one in group)), None)
        if known is None:
            groups.append([cause])
        else:
            known.append(cause)
    return groups


def _share_sensors(one: Cause, other: Cause) -> bool:
    return bool(set(one.sensors) & set(other.sensors))


def _is_same_cause(one: Cause, other: Cause) -> bool:
    """Whether two causes have the same name, or names that data do not tell apart, and a place in common."""
    names = one.fitted.effect, other.fitted.effect
    is_one_name = names[0] == names[1] or names[0] in other.indistinguishable_from
    is_one_name |= names[1] in one.indistinguishable_from
    return is_one_name and _share_sensors(one, other)


def _difference(cause: Cause, side: Side, other: Side) -> EffectDifference:
    return EffectDifference(
        cause.fitted.effect,
        cause.sensors,
        cause.axes,
        cause.probability,
        size_of(cause, side),
        is_shown(cause.fitted, other),
        cause.fitted,
        cause.units,
    )


def _places(unknown: EffectDifference | None) -> set[tuple[int, str]]:
    """Return sensor and axis of the rows in which a side has an unknown part."""
    return set() if unknown is None else set(_rows(unknown))


def _noise(simulation: Side, recording: Side, unknown: Collection[tuple[int, str]]) -> tuple[NoiseDifference, ...]:
    """Return the noise of every axis of both sides.

    Where a known effect stays in it, or an unknown part of both, no difference is told.
    """
    causes = [*simulation.gap.causes, *recording.gap.causes]
    staying = {place for cause in causes if _stays(cause.fitted.effect) for place in _rows(cause)} | set(unknown)
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
    energy, sensors = 0.0, dict[int | str, None]()
    for one in noise:
        if one.differs and (one.recording.sensor, one.recording.axis) not in told:
            small, large = sorted((one.simulation.level_T, one.recording.level_T))
            energy += ((large / small) ** 2 - 1) / len(noise)
            sensors[one.recording.sensor or "scalar"] = None
    return [(f"other noise ({_place(tuple(sensors))})", energy)] if energy > 0 else []
