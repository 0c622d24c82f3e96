"""Whether two sides have the same effects and the same noise, and what the run of one could have shown.

An effect that both sides have is removed from the recording with the simulation's parameters and with its own. What the
former leave beyond the latter, with the calibration fitted again, is the energy of the difference.
"""

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.result import EffectDifference, NoiseDifference
from tam_calibration.comparison.side import CERTAIN, Side
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.grades import SLIGHT
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.effects.removal import removable
from tam_calibration.gap.laws.law import CAUSES
from tam_calibration.gap.noise import AxisNoise
from tam_calibration.gap.result import Cause
from tam_calibration.gap.size import unusable
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.units import FloatArray


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


def differs(simulation: AxisNoise, recording: AxisNoise) -> bool:
    """Return whether two noises of an axis differ by more than chance, and by more than matters in practice.

    Of two white noises the standard deviations of a sample are compared directly, also where their rates differ.
    Else the spectra are compared at the frequencies that both have, in all and in bands of equal information: the level
    of slow noise grows with the duration, its density does not. They too are those of a sample: densities times rates.
    A slight difference of two levels is none in practice: sensors of one kind differ by more.

    Parameters
    ----------
    simulation, recording : AxisNoise
        Of the same axis.
    """
    if simulation.colour == recording.colour == "white":
        ratio = np.log(recording.level_T / simulation.level_T)
        error = np.hypot(
            simulation.level_error_T / simulation.level_T,
            recording.level_error_T / recording.level_T,
        )
        more_T2 = recording.level_T**2 - simulation.level_T**2
        # Near zero the relative error of a level has no bound; the error of its square has.
        before_T2, after_T2 = (2 * noise.level_T * noise.level_error_T for noise in (simulation, recording))
        is_certain = abs(ratio) > CERTAIN * error or abs(more_T2) > CERTAIN * np.hypot(before_T2, after_T2)
        return bool(is_certain and abs(ratio) > np.log1p(SLIGHT))
    (before, before_error), (after, after_error) = _powers_of_both(simulation, recording)
    # With 60 degrees of freedom the ratio of two bands is nearly normal.
    group = np.cumsum(2 / (before_error**2 + after_error**2)) // 60.0
    group = np.minimum(group, group[-1] - 1)
    bands = group[:, None] == np.unique(group)
    bands = np.column_stack([bands, np.ones(len(before), dtype=bool)])
    ratio = np.log((after @ bands) / (before @ bands)) / 2
    error = np.hypot(_error_of_sum(before, before_error, bands), _error_of_sum(after, after_error, bands)) / 2
    return bool((np.abs(ratio) > np.maximum(np.log1p(SLIGHT), CERTAIN * error)).any())


def _error_of_sum(power: FloatArray, error: FloatArray, bands: NDArray[np.bool_]) -> FloatArray:
    return np.sqrt((power * error) ** 2 @ bands) / (power @ bands)


def _powers_of_both(simulation: AxisNoise, recording: AxisNoise) -> list[tuple[FloatArray, FloatArray]]:
    """Return the powers (F,) of two noises at shared frequencies, those of the coarser, and their relative errors."""
    both = simulation, recording
    low, high = max(noise.frequency_hz[0] for noise in both), min(noise.frequency_hz[-1] for noise in both)
    shared = [noise.frequency_hz[(noise.frequency_hz >= low) & (noise.frequency_hz <= high)] for noise in both]
    return [_power_at(noise, min(shared, key=len)) for noise in both]


def _power_at(noise: AxisNoise, frequency_hz: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power of a sample in equal parts of octaves at frequencies (F,), and its relative errors."""
    from scipy.special import ndtri

    spread = np.log(noise.density_high_T2_per_hz / noise.density_low_T2_per_hz)
    error = np.interp(frequency_hz, noise.frequency_hz, spread) / (2 * ndtri(1 - SLIGHT / 2))
    density = np.interp(frequency_hz, noise.frequency_hz, noise.density_T2_per_hz)
    return density * frequency_hz * noise.frequency_hz[-1], error


def is_noise(effect: str) -> bool:
    """Whether an effect is more noise of some axes, which is part of the noise of each axis too.

    Parameters
    ----------
    effect : str
        Its name, or ``UNKNOWN``.
    """
    return effect == NoiseExcess.name


def rows_with(one: Cause | EffectDifference) -> list[tuple[int, str]]:
    """Return sensor and axis of each row in which something is: 0 and no axis for the scalar.

    Parameters
    ----------
    one : Cause or EffectDifference
        With sensors and axes.
    """
    return [
        (0, "") if sensor == "scalar" else (int(sensor), axis)
        for sensor in one.sensors
        for axis in (("",) if sensor == "scalar" else one.axes or "xyz")
    ]


def noise_differences(
    simulation: Side, recording: Side, unknown: Collection[tuple[int, str]]
) -> tuple[NoiseDifference, ...]:
    """Return the noise of every axis of both sides.

    No difference is stated where the residual of which it is taken contains an effect, or an unknown part of both.

    Parameters
    ----------
    simulation, recording : Side
        The two.
    unknown : collection of (int, str)
        Rows in which both have an unknown part.
    """
    causes = [*simulation.gap.causes, *recording.gap.causes]
    # What cannot be removed stays in the residual of which the noise is taken.
    stay = [one for one in causes if not is_noise(one.fitted.effect) and not removable([one.fitted])]
    in_residual = {row for cause in stay for row in rows_with(cause)}
    theirs = {(one.sensor, one.axis): one for one in simulation.gap.noise}
    return tuple(
        NoiseDifference(other, own, row not in in_residual | set(unknown) and differs(other, own))
        for own in recording.gap.noise
        if (other := theirs.get(row := (own.sensor, own.axis))) is not None
    )
