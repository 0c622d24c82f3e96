"""What a simulation lacks, added to its readings: by a plugin as they arrive, or to a whole recording.

Samples arrive in batches of any size; how they are split changes no number. Each class of an effect keeps what one
effect has to know of the samples before. Its ``added`` takes rows (N, 3K + 1) in tesla and their covariates, and
returns the rows with the effect in them.
"""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.noise_stream import NoiseStream
from tam_calibration.comparison.result import Mend
from tam_calibration.effects.covariates import Covariates, Memory
from tam_calibration.effects.displaced import samples_in
from tam_calibration.effects.effect import FoundEffect, LinearEffect
from tam_calibration.effects.library import check_numbers, effect_named
from tam_calibration.effects.removal import agreed_field, filled
from tam_calibration.effects.term import rows_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.observe import add_effects


class StreamedEffect(Protocol):
    """An effect on samples that arrive."""

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        """Return the rows (N, 3K + 1) of the next samples with the effect in them, tesla."""


def streamed(fitted: FittedEffect, generator: np.random.Generator) -> list[StreamedEffect]:
    """Return an effect for samples that arrive: as a whole, or each contribution where it is random.

    Parameters
    ----------
    fitted : FittedEffect
        The effect with its numbers.
    generator : numpy.random.Generator
        Source of the random numbers.

    Raises
    ------
    InputError
        When the effect needs samples that are still to come.
    """
    effect, parts = effect_named(fitted.effect), fitted.contributions
    if isinstance(effect, LinearEffect):
        return [_Recursive(fitted, generator) if effect.is_causal else _FromThePast(fitted, generator)]
    assert isinstance(effect, FoundEffect)
    if effect.stream not in _STREAMS:
        raise InputError(
            f"{fitted.effect} cannot be added to samples as they arrive, for it needs those to come: "
            "add it to the whole recording with tam simulate --from-comparison"
        )
    kind = _STREAMS[effect.stream]
    return [
        kind(replace(fitted, contributions=(part,)), own)
        for part, own in zip(parts, generator.spawn(len(parts)), strict=True)
    ]


class _Recursive:
    """What depends on the sample itself, and on the past through recursions."""

    def __init__(self, fitted: FittedEffect, generator: np.random.Generator) -> None:
        self._fitted, self._generator, self._memory = fitted, generator, Memory()

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        self._memory.rewind()
        here = replace(covariates, memory=self._memory)
        return effect_named(self._fitted.effect).add(rows_T, here, self._fitted, self._generator)


_WINDOW = 256
"""Samples of the past from which an effect of the field's course is worked out: lags of a fifth of it have settled."""

_FITTED, _DEGREE = 12, 4
"""Samples, and the degree of the polynomial through them that foretells the field.

With them the rate of change has the noise of a central difference, and errs by 1 % where the field turns by 0.2 rad in
a sample.
"""

_AHEAD = 3
"""Samples that are foretold: as many as rates of change look at on either side."""


class _FromThePast:
    """What depends on the field's course about the sample, of which that to come is foretold by a polynomial."""

    def __init__(self, fitted: FittedEffect, generator: np.random.Generator) -> None:
        self._fitted, self._generator = fitted, generator
        self._past: Covariates | None = None

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        samples = (slice(index, index + 1) for index in range(len(rows_T)))
        return np.concatenate([self._with(rows_T[one], covariates.take(one)) for one in samples])

    def _with(self, row_T: FloatArray, sample: Covariates) -> FloatArray:
        past = sample if self._past is None else _joined(self._past, sample)
        self._past = past.take(past.stretches[-1]).take(slice(-_WINDOW, None))
        course = _continued(self._past)
        nothing = np.zeros((course.sample_count, row_T.shape[1]))
        signal = effect_named(self._fitted.effect).add(nothing, course, self._fitted, self._generator)
        return np.asarray(row_T + signal[-1 - _AHEAD])


def _joined(past: Covariates, sample: Covariates) -> Covariates:
    """Return time and field of one sample behind those of others."""
    time, field = (np.concatenate(both) for both in ((past.time_s, sample.time_s), (past.field_T, sample.field_T)))
    return Covariates(time, field, past.errors, past.array)


def _continued(past: Covariates) -> Covariates:
    """Return time and field with some samples that a polynomial through the last foretells."""
    count = min(_FITTED, past.sample_count)
    step = float(np.median(np.diff(past.time_s[-count:]))) if count > 1 else 1.0
    known, ahead = (past.time_s[-count:] - past.time_s[-1]) / step, np.arange(1.0, _AHEAD + 1)
    powers = np.arange(1 + min(_DEGREE, count // 2))
    foretold = (
        ahead[:, None] ** powers @ np.linalg.lstsq(known[:, None] ** powers, past.field_T[-count:], rcond=None)[0]
    )
    time = np.concatenate([past.time_s, past.time_s[-1] + step * ahead])
    return Covariates(time, np.concatenate([past.field_T, foretold]), past.errors, past.array)


class _Bursts:
    """Bursts of samples that something strikes at random."""

    def __init__(self, fitted: FittedEffect, generator: np.random.Generator) -> None:
        self._part: Contribution = fitted.contributions[0]
        self._burst = samples_in(self._part, "burst", BLOCK)
        self._late = samples_in(self._part, "samples late", BLOCK)
        self._chance = self._part.values["rate"] / self._burst
        self._when, self._what = generator.spawn(2)
        self._since = self._burst

    def _latest(self, count: int) -> NDArray[np.intp]:
        """Return the first sample (count,) of each sample's latest burst, negative before the batch."""
        index = np.arange(count)
        starts = np.where(self._when.random(count) < self._chance, index, -self._since)
        latest: NDArray[np.intp] = np.maximum.accumulate(starts)
        self._since = int(count - latest[-1])
        return latest

    def _is_struck(self, latest: NDArray[np.intp]) -> NDArray[np.bool_]:
        return np.arange(len(latest)) - latest < self._burst


class _Spikes(_Bursts):
    """Readings that are far off."""

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        is_struck, touched = self._is_struck(self._latest(len(rows_T))), rows_of(self._part, covariates)
        rows, size = rows_T.copy(), self._part.values["size"]
        rows[:, touched] += is_struck[:, None] * self._what.normal(0, size, (len(rows), len(touched)))
        return rows


class _Stale(_Bursts):
    """Readings that repeat the one before the burst, or come some samples late."""

    _past_T: FloatArray | None = None

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        latest = self._latest(len(rows_T))
        past = rows_T[:0] if self._past_T is None else self._past_T
        known = np.concatenate([past, rows_T])
        self._past_T = known[-max(self._burst, self._late) :]
        source = latest - 1 if self._part.term == "repeats" else np.arange(len(rows_T)) - self._late
        rows, is_struck = rows_T.copy(), self._is_struck(latest)
        taken = np.maximum(source[is_struck] + len(past), 0)
        for row in rows_of(self._part, covariates):
            rows[is_struck, row] = known[taken, row]
        return rows


_STREAMS: dict[str, Callable[[FittedEffect, np.random.Generator], StreamedEffect]] = {
    "of_sample": _Recursive,
    "of_course": _FromThePast,
    "spikes": _Spikes,
    "repeats": _Stale,
}
"""The class for each kind of an effect that is no linear one; one of whole recordings has none."""


_STATED_AS = {"temperature_C": "temperature", "current_A": "current", "attitude": "attitude"}


class Additions:
    """Adds the effects and the noise that a simulation lacks to its readings, as a plugin makes them.

    Samples may come one by one or in batches of any size: how they are split changes no number. Times of effects count
    from the first sample. Where time goes back, as when a simulation is reset, all begins anew. An effect that depends
    on how the field goes on foretells that from the samples so far: it is missing in the first sample of a run, and not
    quite as in `mended`. The others are.

    Parameters
    ----------
    mend : Mend
        What the simulation lacks.
    seed : int
        Of all random numbers: give each run of a simulation its own.
    errors : SensorErrors, optional
        Of the simulation's sensors; by default it has none.

    Raises
    ------
    InputError
        When an effect needs samples that are still to come, or is of a sensor or value that there is not.
    """

    def __init__(self, mend: Mend, seed: int = 0, errors: SensorErrors | None = None) -> None:
        self._mend, self._generator = mend, np.random.default_rng(seed)
        self._errors = _errors_of(mend, errors)
        self._begin()

    def _begin(self) -> None:
        """Begin a run."""
        self._newest_s = -np.inf
        noise, *own = self._generator.spawn(1 + len(self._mend.added))
        self._noise = _noise_stream(self._mend, noise)
        with _values_known():
            effects = [
                (effect_named(fitted.effect), streamed(fitted, generator))
                for fitted, generator in zip(self._mend.added, own, strict=True)
            ]
        self._of_field = [one for effect, parts in effects if isinstance(effect, LinearEffect) for one in parts]
        ordered = sorted(effects, key=lambda pair: pair[0].output_stage)
        self._of_reading = [one for effect, parts in ordered if not isinstance(effect, LinearEffect) for one in parts]

    def __call__(
        self,
        readings_T: FloatArray,
        time_s: FloatArray | float,
        scalar_T: FloatArray | float | None = None,
        temperature_C: FloatArray | float | None = None,
        current_A: FloatArray | float | None = None,
        attitude: FloatArray | None = None,
    ) -> tuple[FloatArray, FloatArray | None]:
        """Return the readings, and those of the scalar magnetometer, with what they lacked.

        Parameters
        ----------
        readings_T : (K, 3) or (N, K, 3) array
            Of one sample, or of a batch of samples that follow each other, tesla.
        time_s : float or (N,) array
            Their times, seconds.
        scalar_T : float or (N,) array, optional
            Intensity from the scalar magnetometer, tesla.
        temperature_C, current_A : float or (N,) array, optional
            Channels that the effects follow, °C and ampere.
        attitude : (4,) or (N, 4) array, optional
            Quaternions x, y, z, w from the array frame to the world.

        Returns
        -------
        readings_T : (K, 3) or (N, K, 3) array
            Tesla.
        scalar_T : (1,) or (N,) array or None
            Tesla; None where there was none.

        Raises
        ------
        InputError
            When shapes do not match, or a channel is missing that an effect follows.
        """
        shape = np.shape(readings_T)
        scalar, temperature, current = (
            None if channel is None else np.atleast_1d(channel) for channel in (scalar_T, temperature_C, current_A)
        )
        turns = None if attitude is None else np.reshape(attitude, (-1, 4))
        readings = np.reshape(readings_T, (-1, *shape[-2:]))
        batch = Recording(np.atleast_1d(time_s), readings, scalar, temperature, current, turns)
        made = self._made(batch)
        return made.readings_T.reshape(shape), made.scalar_T

    def _made(self, batch: Recording) -> Recording:
        """Return the next samples with what they lacked."""
        _check(self._mend, batch)
        if batch.time_s[0] <= self._newest_s:
            self._begin()
        if not np.isfinite(self._newest_s):
            self._first_s = float(batch.time_s[0])
        self._newest_s = float(batch.time_s[-1])
        covariates = _covariates(self._mend, batch, self._errors, self._first_s)
        rows = _rows(batch)
        with _values_known():
            for effect in self._of_field:
                rows = effect.added(rows, covariates)
            rows = rows + self._noise.drawn(batch.time_s)
            for effect in self._of_reading:
                rows = effect.added(rows, covariates)
        return _recording(batch, rows)


def mended(recording: Recording, mend: Mend, seed: int, errors: SensorErrors | None = None) -> Recording:
    """Return a simulation's recording with the effects and the noise that it lacks; their times count from its start.

    What the simulation should not have, ``mend.removed``, must have been taken off before.

    Parameters
    ----------
    recording : Recording
        As the simulation made it.
    mend : Mend
        What the simulation lacks.
    seed : int
        Of all random numbers.
    errors : SensorErrors, optional
        Of the simulation's sensors; by default it has none.

    Raises
    ------
    InputError
        When the recording has another number of sensors, or lacks a channel that an effect follows.
    """
    errors = _errors_of(mend, errors)
    _check(mend, recording)
    run = filled(recording)
    covariates = _covariates(mend, run, errors, float(run.time_s[0]))
    noise, *own = np.random.default_rng(seed).spawn(1 + len(mend.added))
    rows = add_effects(_rows(run), covariates, mend.added, own, "field")
    rows = rows + _noise_stream(mend, noise).drawn(run.time_s)
    return _recording(recording, add_effects(rows, covariates, mend.added, own, "reading"))


def _errors_of(mend: Mend, errors: SensorErrors | None) -> SensorErrors:
    """Return the errors of the simulation's sensors, for which the numbers of all effects must make sense."""
    array = mend.calibration.array
    errors = errors or SensorErrors.none(array.sensor_count)
    for fitted in mend.added:
        check_numbers(fitted, errors, array)
        if any(part.sensor >= array.sensor_count for part in fitted.contributions):
            raise InputError(f"{fitted.effect} acts on a sensor beyond the {array.sensor_count} that there are")
    return errors


@contextmanager
def _values_known() -> Iterator[None]:
    """Tell in a sentence which value an effect lacks."""
    try:
        yield
    except KeyError as missing:
        raise InputError(f"the mend has an effect that needs the value {missing}") from None


def _check(mend: Mend, recording: Recording) -> None:
    count = mend.calibration.array.sensor_count
    if recording.sensor_count != count:
        raise InputError(f"the simulation has {recording.sensor_count} sensors, and the mend is of {count}")
    for fitted in mend.added:
        _check_channels(fitted, recording)


def _check_channels(fitted: FittedEffect, recording: Recording) -> None:
    effect = effect_named(fitted.effect)
    if isinstance(effect, LinearEffect) and (missing := effect.needs(fitted)[len(effect.channels) :]):
        raise InputError(
            f"{fitted.effect} follows {missing[0]}, which samples of a simulator do not have: leave it out"
        )
    for channel in effect.channels:
        if getattr(recording, channel) is None:
            raise InputError(f"{fitted.effect} follows the {_STATED_AS[channel]}: give {channel} of the simulation")


def _noise_stream(mend: Mend, generator: np.random.Generator) -> NoiseStream:
    calibration = mend.calibration
    span_s = calibration.time_span_s[1] - calibration.time_span_s[0]
    return NoiseStream(mend.noise, 3 * calibration.array.sensor_count + 1, mend.rate_hz, span_s, generator)


def _covariates(mend: Mend, recording: Recording, errors: SensorErrors, first_s: float) -> Covariates:
    """Return what the effects follow, in a run whose first sample had the time ``first_s``."""
    array = mend.calibration.array
    field = agreed_field(recording.readings_T, errors, array)
    return replace(Covariates.of(recording, field, errors, array), time_s=recording.time_s - first_s)


def _rows(recording: Recording) -> FloatArray:
    scalar = np.full(recording.sample_count, np.nan) if recording.scalar_T is None else recording.scalar_T
    return np.column_stack([recording.readings_T.reshape(recording.sample_count, -1), scalar])


def _recording(recording: Recording, rows_T: FloatArray) -> Recording:
    """Return a recording with other readings; the scalar is silent where it was."""
    scalar = None
    if recording.scalar_T is not None:
        scalar = np.where(np.isfinite(recording.scalar_T), rows_T[:, -1], np.nan)
    return replace(recording, readings_T=rows_T[:, :-1].reshape(recording.readings_T.shape), scalar_T=scalar)
