"""The noise of each axis in both recordings, and whether it differs."""

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.result import EffectDifference, NoiseDifference, Side
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.noise_excess import NoiseExcess
from tam_calibration.gap.noise import INTERVAL, AxisNoise
from tam_calibration.gap.result import Cause
from tam_calibration.model.units import FloatArray

LEAST_DIFFERENCE = 0.05
"""Relative difference of two levels that is none in practice: sensors of one kind differ by more."""

CERTAIN = 4.5
"""Standard errors from which two noises differ: of 13 rows at 15 frequencies by chance in one of a thousand."""


def differs(simulation: AxisNoise, recording: AxisNoise) -> bool:
    """Return whether two noises of an axis differ by more than chance, and by more than matters in practice.

    Of two white noises the standard deviations of a sample are compared directly, also where their rates differ.
    Else the spectra are compared at the frequencies that both have, in all and in bands of equal information: the level
    of slow noise grows with the duration, its density does not. They too are those of a sample: densities times rates.

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
        return bool(is_certain and abs(ratio) > np.log1p(LEAST_DIFFERENCE))
    (before, before_error), (after, after_error) = _powers_of_both(simulation, recording)
    # With 60 degrees of freedom the ratio of two bands is nearly normal.
    group = np.cumsum(2 / (before_error**2 + after_error**2)) // 60.0
    group = np.minimum(group, group[-1] - 1)
    bands = group[:, None] == np.unique(group)
    bands = np.column_stack([bands, np.ones(len(before), dtype=bool)])
    ratio = np.log((after @ bands) / (before @ bands)) / 2
    error = np.hypot(_error_of_sum(before, before_error, bands), _error_of_sum(after, after_error, bands)) / 2
    return bool((np.abs(ratio) > np.maximum(np.log1p(LEAST_DIFFERENCE), CERTAIN * error)).any())


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
    error = np.interp(frequency_hz, noise.frequency_hz, spread) / (2 * ndtri((1 + INTERVAL) / 2))
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
    in_residual = {row for cause in causes if _stays_in_residual(cause.fitted.effect) for row in rows_with(cause)}
    theirs = {(one.sensor, one.axis): one for one in simulation.gap.noise}
    return tuple(
        NoiseDifference(other, own, row not in in_residual | set(unknown) and differs(other, own))
        for own in recording.gap.noise
        if (other := theirs.get(row := (own.sensor, own.axis))) is not None
    )


def _stays_in_residual(effect: str) -> bool:
    """Whether an effect cannot be removed from the residual of which the noise is taken."""
    return not is_noise(effect) and not isinstance(effect_named(effect), LinearEffect)
