"""What a simulation lacks, added to its readings: by a plugin as they arrive, or to a complete recording."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from tam_calibration.comparison.mend import Mend
from tam_calibration.comparison.streams import NoiseStream, StreamedEffect, streamed
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.library import check_numbers, effect_named
from tam_calibration.effects.removal import agreed_field, filled
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording, channel_in_words
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.observe import add_effects


class Additions:
    """Adds the effects and the noise that a simulation lacks to its readings, as a plugin makes them.

    Samples may come one by one or in batches of any size: how they are split changes no number. Times of effects count
    from the first sample. Where time goes back, as when a simulation is reset, all begins anew. An effect that depends
    on how the field goes on extrapolates that from the samples so far: it is missing in the first sample of a run, and
    differs a little from `mended`. The others do not.

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
        of_field: list[StreamedEffect] = []
        of_reading: list[StreamedEffect] = []
        pairs = zip(self._mend.added, own, strict=True)
        with _values_known():
            for fitted, generator in sorted(pairs, key=lambda pair: effect_named(pair[0].effect).output_stage):
                is_of_field = isinstance(effect_named(fitted.effect), LinearEffect)
                (of_field if is_of_field else of_reading).extend(streamed(fitted, generator))
        self._steps = [*of_field, _noise_stream(self._mend, noise), *of_reading]

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
        _check(self._mend, batch)
        if batch.time_s[0] <= self._newest_s:
            self._begin()
        if not np.isfinite(self._newest_s):
            self._first_s = float(batch.time_s[0])
        self._newest_s = float(batch.time_s[-1])
        covariates = _covariates(self._mend, batch, self._errors, self._first_s)
        rows = _rows(batch)
        with _values_known():
            for step in self._steps:
                rows = step.added(rows, covariates)
        made = _recording(batch, rows)
        return made.readings_T.reshape(shape), made.scalar_T


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
        effect = effect_named(fitted.effect)
        if isinstance(effect, LinearEffect) and (further := effect.needs(fitted)[len(effect.channels) :]):
            raise InputError(
                f"{fitted.effect} follows {further[0]}, which samples of a simulator do not have: leave it out"
            )
        for channel in effect.channels:
            if getattr(recording, channel) is None:
                words = channel_in_words(channel)
                raise InputError(f"{fitted.effect} follows the {words}: give {channel} of the simulation")


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
