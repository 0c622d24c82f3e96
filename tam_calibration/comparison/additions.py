"""What a simulation lacks, added to its readings: by a plugin as they arrive, or to a complete recording.

Samples arrive in batches of any size, and the split changes no number.

Slow noise of the density 2 w²/r (k/f)^a is a sum of first-order processes whose time constants cover the frequencies
(Keshner, 1/f noise, Proc. IEEE 70, 1982, p. 212), and a band is an oscillator that white noise drives, an AR(2)
process. Both are modes z' = -λ z + white noise, with 1/λ the time constant of a process, or λ = π Δf - 2πi f of a band
about f of the width Δf. Over a step h

    z(t + h) = exp(-λ h) z(t) + k,   E |k|² = (1 - exp(-2 Re λ h)) / (2 Re λ),   E k² = (1 - exp(-2 λ h)) / (2 λ),

for white noise of unit density, so that modes keep their density whatever the steps of time are. What is read is
x = Re(c z). Its covariance over n steps is Re(G p^n), with p = exp(-λ h) = ρ exp(iθ), |c| = 1 and
G = (E |z|² + c² E z²) / 2; it is that of the AR(2) process with the poles p and p* where
tan(arg G) = -cot(θ) (1 - ρ²) / (1 + ρ²), which fixes c; for bands above a third of the rate it comes near.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.comparison.mend import Mend, NoiseTerm, slow_modes
from tam_calibration.effects.covariates import NEIGHBOURS, Covariates
from tam_calibration.effects.effect import Effect, FoundEffect, LinearEffect, StreamKind
from tam_calibration.effects.library import check_numbers, effect_named
from tam_calibration.effects.recursions import Memory, follow
from tam_calibration.effects.removal import agreed_field, filled
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import BLOCK, Recording, channel_in_words, is_further
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.observe import add_effects, with_rows


class NoiseStream:
    """Draws noise for samples that arrive in batches of any size; how they are split changes no number.

    Where time goes back, slow noise and bands begin anew.

    Parameters
    ----------
    mend : Mend
        Its noise is to be added, of each row at most once.
    generator : numpy.random.Generator
        Source of the random numbers.
    """

    def __init__(self, mend: Mend, generator: np.random.Generator) -> None:
        self._white, self._kicks = generator.spawn(2)
        row_count = 3 * mend.calibration.array.sensor_count + 1
        self._white_T = np.zeros(row_count)
        modes: list[tuple[int, complex, float]] = []
        for term in mend.noise:
            row = row_count - 1 if term.sensor == 0 else 3 * (term.sensor - 1) + "xyz".index(term.axis)
            self._white_T[row] = term.added_white_T
            modes += [(row, *mode) for mode in _modes(mend, term)]
        self._to_rows = np.eye(row_count)[[row for row, _, _ in modes]].reshape(-1, row_count)
        self._decay = np.array([decay for _, decay, _ in modes], dtype=complex)
        self._reading = _readings_of(self._decay, mend.rate_hz)
        unit = (0.5 / self._decay.real + (self._reading**2 * 0.5 / self._decay).real) / 2
        self._drive_T = np.sqrt(np.array([variance for _, _, variance in modes]) / unit)
        self._state = np.zeros(len(modes), complex)
        self._newest_s = np.inf

    def drawn(self, time_s: FloatArray) -> FloatArray:
        """Return the noise (N, 3K + 1) of the next samples, at times (N,) in seconds, tesla."""
        noise: FloatArray = self._white.normal(size=(len(time_s), len(self._white_T))) * self._white_T
        if len(self._decay):
            blocks = [self._coloured(time_s[start : start + BLOCK]) for start in range(0, len(time_s), BLOCK)]
            noise += np.concatenate(blocks)
        return noise

    def _coloured(self, time_s: FloatArray) -> FloatArray:
        step = np.diff(time_s, prepend=self._newest_s)[:, None]
        self._newest_s = float(time_s[-1])
        # After a pause, or where time goes back, nothing is left of a mode: its next kick makes it anew.
        exponent = np.where(step > 0, np.maximum(step, 0) * self._decay, 1e3)
        size = -np.expm1(-2 * exponent.real) / (2 * self._decay.real)
        square = -np.expm1(-2 * exponent) / (2 * self._decay)
        along, across = (np.sqrt(np.maximum(size + sign * np.abs(square), 0) / 2) for sign in (1, -1))
        drawn = self._kicks.normal(size=(*exponent.shape, 2))
        kick = self._drive_T * np.exp(0.5j * np.angle(square)) * (along * drawn[..., 0] + 1j * across * drawn[..., 1])
        modes: NDArray[np.complexfloating] = follow(kick, np.zeros_like(kick), self._state, exponent)[1:]
        self._state = modes[-1]
        return (self._reading * modes).real @ self._to_rows


def _modes(mend: Mend, term: NoiseTerm) -> list[tuple[complex, float]]:
    """Return λ in 1/s and the variance in T² of each mode of a term."""
    constants_s, variances_T2 = slow_modes(mend, term)
    modes = list(zip(1 / constants_s.astype(complex), variances_T2, strict=True))
    if term.band_hz is not None:
        low, high = term.band_hz
        modes.append((np.pi * complex(high - low, -high - low), term.band_T**2))
    return modes


def _readings_of(decay: NDArray[np.complexfloating], rate_hz: float) -> NDArray[np.complexfloating]:
    """Return c of each mode: at the rate of the recording a band is an AR(2) process, as near as it can be."""
    turn = np.where(decay.imag == 0, np.pi / 2, -decay.imag / rate_hz)
    wanted = -np.arctan(np.tanh(decay.real / rate_hz) / np.tan(turn))
    lean = decay.real / np.abs(decay)  # of |E z²| to E |z|²
    angle = wanted + np.arcsin(np.clip(np.sin(wanted) / lean, -1, 1))
    return np.asarray(np.exp(0.5j * (angle + np.angle(decay))))


_WINDOW = 256
"""Samples of the past from which an effect of the field's course is worked out: lags of a fifth of it have settled."""

_FITTED, _DEGREE = 12, 4
"""Samples, and the degree of the polynomial through them that extrapolates the field.

With them the rate of change has the noise of a central difference, and errs by 1 % where the field turns by 0.2 rad in
a sample.
"""


def _add_from_the_past(
    rows_T: FloatArray, covariates: Covariates, fitted: FittedEffect, generator: np.random.Generator
) -> FloatArray:
    """Return rows with an effect of the field's course about each sample, which a polynomial extrapolates."""
    memory, rows = covariates.memory or Memory(), rows_T.copy()
    past: Covariates | None = memory.recall(None)
    for index in range(len(rows)):
        sample = covariates.take(slice(index, index + 1))
        past = sample if past is None else _joined(past, sample.time_s, sample.field_T)
        past = past.take(past.stretches[-1]).take(slice(-_WINDOW, None))
        course = _continued(past)
        nothing = np.zeros((course.sample_count, rows.shape[1]))
        rows[index] += effect_named(fitted.effect).add(nothing, course, fitted, generator)[-1 - NEIGHBOURS // 2]
    memory.keep(past)
    return rows


def _joined(past: Covariates, time_s: FloatArray, field_T: FloatArray) -> Covariates:
    """Return time and field of samples with those of further ones (n,) and (n, 3) behind them."""
    time, field = np.concatenate([past.time_s, time_s]), np.concatenate([past.field_T, field_T])
    return Covariates(time, field, past.errors, past.array)


def _continued(past: Covariates) -> Covariates:
    """Return time and field with samples that a polynomial through the last ones extrapolates.

    They are as many as rates of change look at on either side.
    """
    count = min(_FITTED, past.sample_count)
    step = float(np.median(np.diff(past.time_s[-count:]))) if count > 1 else 1.0
    known, ahead = (past.time_s[-count:] - past.time_s[-1]) / step, np.arange(1.0, NEIGHBOURS // 2 + 1)
    powers = np.arange(1 + min(_DEGREE, count // 2))
    coefficients = np.linalg.lstsq(known[:, None] ** powers, past.field_T[-count:], rcond=None)[0]
    return _joined(past, past.time_s[-1] + step * ahead, ahead[:, None] ** powers @ coefficients)


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
        for fitted in mend.added:
            if _stream_of(effect_named(fitted.effect)) == "of_whole":
                raise InputError(
                    f"{fitted.effect} cannot be added to samples as they arrive, for it needs those to come: "
                    "add it to the whole recording with tam simulate --from-comparison"
                )
        self._begin()

    def _begin(self) -> None:
        """Begin a run."""
        self._newest_s = -np.inf
        noise, *sources = self._generator.spawn(1 + len(self._mend.added))
        self._noise, self._memory = NoiseStream(self._mend, noise), Memory()
        pairs = zip(self._mend.added, sources, strict=True)
        self._effects = sorted(pairs, key=lambda pair: effect_named(pair[0].effect).output_stage)

    def _added(self, rows_T: FloatArray, covariates: Covariates, is_of_field: bool) -> FloatArray:
        """Return the rows with the effects of the field in them, or with those of the readings."""
        for fitted, source in self._effects:
            effect = effect_named(fitted.effect)
            if isinstance(effect, LinearEffect) == is_of_field:
                add = effect.add if _stream_of(effect) == "of_sample" else _add_from_the_past
                rows_T = add(rows_T, covariates, fitted, source)
        return rows_T

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
            When shapes do not match, a channel is missing that an effect follows, or an effect lacks a value.
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
        self._memory.rewind()
        covariates = _covariates(self._mend, batch, self._errors, self._first_s, self._memory)
        try:
            rows = self._added(_rows(batch), covariates, is_of_field=True)
            rows = self._added(rows + self._noise.drawn(covariates.time_s), covariates, is_of_field=False)
        except KeyError as missing:
            raise InputError(f"an effect to add needs the value {missing}") from None
        made = with_rows(batch, rows)
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
    rows = rows + NoiseStream(mend, noise).drawn(run.time_s)
    return with_rows(recording, add_effects(rows, covariates, mend.added, own, "reading"))


def _stream_of(effect: Effect) -> StreamKind:
    """Return how an effect is added to samples as they arrive."""
    if isinstance(effect, LinearEffect):
        return "of_sample" if effect.is_causal else "of_course"
    assert isinstance(effect, FoundEffect)
    return effect.stream


def _errors_of(mend: Mend, errors: SensorErrors | None) -> SensorErrors:
    """Return the errors of the simulation's sensors, for which the numbers of all effects must make sense."""
    array = mend.calibration.array
    errors = errors or SensorErrors.none(array.sensor_count)
    for fitted in mend.added:
        check_numbers(fitted, errors, array)
        if any(part.sensor >= array.sensor_count for part in fitted.contributions):
            raise InputError(f"{fitted.effect} acts on a sensor beyond the {array.sensor_count} that there are")
    return errors


def _check(mend: Mend, recording: Recording) -> None:
    count = mend.calibration.array.sensor_count
    if recording.sensor_count != count:
        raise InputError(f"the simulation has {recording.sensor_count} sensors, and the mend is of {count}")
    for fitted in mend.added:
        effect = effect_named(fitted.effect)
        if further := [name for name in effect.needs(fitted) if is_further(name) or name not in effect.channels]:
            raise InputError(
                f"{fitted.effect} follows {further[0]}, which samples of a simulator do not have: leave it out"
            )
        for channel in effect.channels:
            if getattr(recording, channel) is None:
                words = channel_in_words(channel)
                raise InputError(f"{fitted.effect} follows the {words}: give {channel} of the simulation")


def _covariates(
    mend: Mend, recording: Recording, errors: SensorErrors, first_s: float, memory: Memory | None = None
) -> Covariates:
    """Return what the effects follow, in a run whose first sample had the time ``first_s``."""
    array = mend.calibration.array
    field = agreed_field(recording.readings_T, errors, array)
    return replace(Covariates.of(recording, field, errors, array), time_s=recording.time_s - first_s, memory=memory)


def _rows(recording: Recording) -> FloatArray:
    scalar = np.full(recording.sample_count, np.nan) if recording.scalar_T is None else recording.scalar_T
    return np.column_stack([recording.readings_T.reshape(recording.sample_count, -1), scalar])
