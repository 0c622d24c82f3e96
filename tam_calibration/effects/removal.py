"""The signal of known effects in a recording, or in samples as they arrive, for its removal."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.least_squares import Elimination
from tam_calibration.effects.effect import SCALAR, Covariates, FittedEffect, LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.recursions import Memory
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import BLOCK, Recording, channel_in_words
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Added:
    """The signal of effects in N samples.

    Parameters
    ----------
    rows_T : (N, 3K + 1) array
        Signal in the readings of all sensors and in the scalar, tesla; 0 where it is not known.
    is_known : (N, E) array of bool
        Whether a sample has the channels that each effect needs.
    """

    rows_T: FloatArray
    is_known: NDArray[np.bool_]


class EffectStream:
    """Computes the signal of effects in samples that arrive in batches of any size, as for all samples at once.

    Where time goes back, as when a recording is played again, all recursions restart.

    Parameters
    ----------
    effects : sequence of FittedEffect
        Linear effects. One that is not causal must get all samples in one batch.
    errors : SensorErrors
        Of the calibration that they were fitted with.
    array : Array
        Positions and noise.
    """

    def __init__(self, effects: Sequence[FittedEffect], errors: SensorErrors, array: KnownNoiseArray) -> None:
        self._effects = [(linear_effect(fitted), fitted) for fitted in effects]
        self._errors, self._array = errors, array
        self._unmix = Elimination.of_sensors(errors, array.vector_noise_T).unmixing
        self._newest_s = -np.inf
        self._begin()

    def _begin(self) -> None:
        # The signal depends on the field, and the field on the signal: each pass squares the error.
        self._memories = [[Memory() for _ in self._effects] for _ in range(2)]

    def go_on(self, other: "EffectStream") -> None:
        """Take up the recursions of another stream, where it is of the same effects beside other errors."""
        if self._effects == other._effects:
            self._memories, self._newest_s = other._memories, other._newest_s

    def added(self, recording: Recording) -> Added:
        """Return what the effects added to the next samples; their channels may hold NaN."""
        if recording.time_s[0] <= self._newest_s:
            self._begin()
        self._newest_s = float(recording.time_s[-1])
        unbiased = (recording.readings_T - self._errors.bias_T).reshape(recording.sample_count, -1)
        total = np.zeros((recording.sample_count, unbiased.shape[1] + 1))
        is_known = np.column_stack([_knows(recording, effect.needs(fitted)) for effect, fitted in self._effects])
        for memories in self._memories:
            field = (unbiased - total[:, :-1]) @ self._unmix.T
            covariates = Covariates.of(recording, field, self._errors, self._array)
            total = np.zeros_like(total)
            for (effect, fitted), memory, known in zip(self._effects, memories, is_known.T, strict=True):
                if known.any():
                    memory.rewind()
                    here = covariates if known.all() else covariates.take(known)
                    total[known] += effect.signal(replace(here, memory=memory), fitted)
        return Added(total, is_known)


def added_to(
    recording: Recording, effects: Sequence[FittedEffect], errors: SensorErrors, array: KnownNoiseArray
) -> FloatArray:
    """Return what effects added to the rows of a recording, (N, 3K + 1), tesla.

    Holes in its channels are filled as in ``filled``.

    Parameters
    ----------
    recording : Recording
        N samples of K sensors, with the channels that the effects need.
    effects : sequence of FittedEffect
        Linear effects.
    errors : SensorErrors
        Of the calibration that the effects were fitted with.
    array : KnownNoiseArray
        Positions and noise of the sensors.

    Raises
    ------
    InputError
        When the recording lacks a channel that an effect needs.
    """
    require_channels(recording, effects)
    recording = filled(recording)
    stream = EffectStream(effects, errors, array)
    count = recording.sample_count
    size = BLOCK if all(linear_effect(fitted).is_causal for fitted in effects) else count
    batches = [recording.take(slice(start, start + size)) for start in range(0, count, size)]
    return np.concatenate([stream.added(batch).rows_T for batch in batches])


def require_channels(recording: Recording, effects: Iterable[FittedEffect]) -> None:
    """Check that a recording has the channels that effects need.

    Parameters
    ----------
    recording : Recording
        Of which they are to be taken off.
    effects : iterable of FittedEffect
        Linear effects.

    Raises
    ------
    InputError
        It names the effect and what is missing.
    """
    for fitted in effects:
        needed = linear_effect(fitted).needs(fitted)
        missing = [channel_in_words(name) for name in needed if recording.channel(name) is None]
        if missing:
            channels = " and ".join(missing)
            raise InputError(
                f"{fitted.effect} is to be taken off, which needs the {channels}, and the recording has no such "
                f"channel: record the {channels} too, or use a calibration without this effect"
            )


def filled(recording: Recording) -> Recording:
    """Return the recording with holes in its channels filled from their neighbours.

    Readings, scalar and angular velocity stay as they are: what the array did in a hole is not known.
    """
    whole = recording.values()
    for name in whole.keys() - {"time_s", "readings_T", "scalar_T", "angular_velocity_rad_s"}:
        values, known = whole[name], _knows(recording, (name,))
        if name == "attitude":
            nearest = np.round(np.interp(np.arange(len(known)), np.flatnonzero(known), np.arange(known.sum())))
            whole[name] = values[known][nearest.astype(int)]
        else:
            columns = values.reshape(len(known), -1).T
            straight = [np.interp(recording.time_s, recording.time_s[known], column[known]) for column in columns]
            whole[name] = np.array(straight).T.reshape(values.shape)
    return Recording.of_values(whole)


def attitude_known(recording: Recording) -> NDArray[np.bool_] | None:
    """Return in which samples (N,) the attitude is known; None where it was not recorded."""
    return None if recording.attitude is None else _knows(recording, ("attitude",))


def removable(effects: Iterable[FittedEffect]) -> tuple[FittedEffect, ...]:
    """Return the effects that can be removed: those whose signal follows from recorded channels."""
    return tuple(fitted for fitted in effects if isinstance(effect_named(fitted.effect), LinearEffect))


def of_array(effects: Iterable[FittedEffect]) -> tuple[FittedEffect, ...]:
    """Return the removable effects that go with the array, and not with the site where it was calibrated."""
    return tuple(fitted for fitted in removable(effects) if not linear_effect(fitted).is_of_site)


def of_sensors(effects: Iterable[FittedEffect]) -> tuple[FittedEffect, ...]:
    """Return the removable effects that belong to the array, as far as they act on its sensors."""
    return tuple(filter(None, map(on_sensors, effects)))


def on_sensors(fitted: FittedEffect) -> FittedEffect | None:
    """Return the part of an effect on the sensors; None where it cannot be removed, or belongs to the site."""
    contributions = tuple(one for one in fitted.contributions if one.sensor != SCALAR)
    return replace(fitted, contributions=contributions) if contributions and of_array([fitted]) else None


def linear_effect(fitted: FittedEffect) -> LinearEffect:
    """Return the effect itself, which must be one that adds to the rows."""
    effect = effect_named(fitted.effect)
    if not isinstance(effect, LinearEffect):
        raise InputError(f"{fitted.effect} cannot be taken off readings: nothing tells what it added to each of them")
    return effect


def _knows(recording: Recording, channels: Sequence[str]) -> NDArray[np.bool_]:
    known = np.ones(recording.sample_count, dtype=bool)
    for name in channels:
        values = recording.channel(name)
        if values is None:
            return np.zeros_like(known)
        known &= np.isfinite(values).reshape(len(values), -1).all(axis=1)
    return known


def agreed_field(
    readings_T: FloatArray, errors: SensorErrors, array: KnownNoiseArray, is_trusted: NDArray[np.bool_] | None = None
) -> FloatArray:
    """Return the least-squares field (N, 3) of readings (N, K, 3), each weighted by its noise, tesla.

    Axes that are not trusted (3K,) do not count.

    Parameters
    ----------
    readings_T : (N, K, 3) array
        Readings of K sensors, tesla.
    errors : SensorErrors
        Bias and matrix of each sensor.
    array : KnownNoiseArray
        Noise of the sensors.
    is_trusted : (3K,) array of bool, optional
        Axes that count; by default all.
    """
    unbiased = (readings_T - errors.bias_T).reshape(len(readings_T), -1)
    weight = np.where(True if is_trusted is None else is_trusted, 1 / np.repeat(array.vector_noise_T, 3), 0.0)
    return unbiased @ Elimination.of(errors.matrix.reshape(-1, 3), weight).unmixing.T
