"""What one side has and the other has not: effects, parameters and noise, each with its energy.

The energy of an effect is the part of the gap of its side that it explains, in squared noise floors.

An effect that both sides have is taken off the recording with the simulation's parameters and with its own: what the
former leave beyond the latter, with the calibration fitted beside both, is the energy of the difference.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.comparison.noise import differs
from tam_calibration.comparison.result import UNKNOWN, EffectDifference, NoiseDifference, OtherParameters, Side
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.gap.laws.causes import CAUSES
from tam_calibration.gap.result import Cause
from tam_calibration.gap.size import unusable
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.sensors_in_words import numbered

_OPEN = ("partly_explained", "unexplained")
"""Verdicts that leave an unknown part."""

_LIKELY = 0.5
"""Probability below which a cause beside an unknown part is not told: it belongs to that part."""

_UNKNOWN_ALIKE = 0.5
"""Part by which two unknown parts may differ in size and still be one: twice that of runs of one phone, or one IMU."""


def likely_causes(side: Side) -> list[Cause]:
    """Return the causes that are told by their names, all where they explain the recording.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    return [cause for cause in side.gap.causes if side.gap.verdict not in _OPEN or cause.probability >= _LIKELY]


def size_of(cause: Cause, side: Side) -> float:
    """Return the root of the energy that a cause explains, in noise floors.

    Parameters
    ----------
    cause : Cause
        Of the diagnosis.
    side : Side
        That was diagnosed.
    """
    size = side.gap.size
    return float(np.sqrt(max(cause.share * (size.before**2 - size.after**2), 0.0)))


def unknown_part(side: Side) -> EffectDifference | None:
    """Return what no effect explains of a side, or only one that is unlikely; None where nothing is open.

    Parameters
    ----------
    side : Side
        With its diagnosis.
    """
    gap = side.gap
    if gap.verdict not in _OPEN:
        return None
    energy = gap.size.before**2 - sum(size_of(cause, side) ** 2 for cause in likely_causes(side))
    probability = gap.probabilities.get("none_of_these", float("nan"))
    return EffectDifference(UNKNOWN, gap.where.sensors, gap.where.axes, probability, float(np.sqrt(energy)), True)


def are_alike(one: EffectDifference, other: EffectDifference) -> bool:
    """Whether two unknown parts may be the same: of one place, and nearly of one size.

    Parameters
    ----------
    one, other : EffectDifference
        Both unknown.
    """
    small, large = sorted((one.size, other.size))
    return bool(set(one.sensors) & set(other.sensors)) and large - small <= _UNKNOWN_ALIKE * large


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
    has_phase = any("tone" in one.course for one in CAUSES if one.name == name)
    return not (effect.is_free_in_time or has_phase)


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
    return effect == NoiseExcess.name


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
    theirs = {(one.sensor, one.axis): one for one in simulation.gap.noise}
    return tuple(
        NoiseDifference(
            theirs[own.sensor, own.axis],
            own,
            (own.sensor, own.axis) not in staying and differs(theirs[own.sensor, own.axis], own),
        )
        for own in recording.gap.noise
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
