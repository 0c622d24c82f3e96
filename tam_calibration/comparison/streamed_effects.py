"""Effects that are added to samples as they arrive.

Samples arrive in batches of any size; how they are split changes no number. Each class keeps what one effect has to
know of the samples before. Its ``added`` takes rows (N, 3K + 1) in tesla and their covariates, and returns the rows
with the effect in them.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import FoundEffect, LinearEffect
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.outliers import samples_in
from tam_calibration.effects.recursions import Memory
from tam_calibration.effects.term import rows_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import BLOCK
from tam_calibration.model.units import FloatArray


class StreamedEffect(Protocol):
    """An effect on samples that arrive."""

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        """Return the rows (N, 3K + 1) of the next samples with the effect in them, tesla."""


def streamed(fitted: FittedEffect, generator: np.random.Generator) -> list[StreamedEffect]:
    """Return an effect for samples that arrive; where it is random, each contribution by itself.

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
"""Samples, and the degree of the polynomial through them that extrapolates the field.

With them the rate of change has the noise of a central difference, and errs by 1 % where the field turns by 0.2 rad in
a sample.
"""

_AHEAD = 3
"""Samples that are extrapolated: as many as rates of change look at on either side."""


class _FromThePast:
    """What depends on the field's course about the sample, which a polynomial extrapolates."""

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
    """Return time and field with some samples that a polynomial through the last ones extrapolates."""
    count = min(_FITTED, past.sample_count)
    step = float(np.median(np.diff(past.time_s[-count:]))) if count > 1 else 1.0
    known, ahead = (past.time_s[-count:] - past.time_s[-1]) / step, np.arange(1.0, _AHEAD + 1)
    powers = np.arange(1 + min(_DEGREE, count // 2))
    extrapolated = (
        ahead[:, None] ** powers @ np.linalg.lstsq(known[:, None] ** powers, past.field_T[-count:], rcond=None)[0]
    )
    time = np.concatenate([past.time_s, past.time_s[-1] + step * ahead])
    return Covariates(time, np.concatenate([past.field_T, extrapolated]), past.errors, past.array)


class _Spikes:
    """Bursts of samples at random times in which readings are far off."""

    def __init__(self, fitted: FittedEffect, generator: np.random.Generator) -> None:
        (self._part,) = fitted.contributions
        self._burst = samples_in(self._part, "burst", BLOCK)
        self._chance = self._part.values["rate"] / self._burst
        self._when, self._what = generator.spawn(2)
        self._since = self._burst

    def added(self, rows_T: FloatArray, covariates: Covariates) -> FloatArray:
        index, touched = np.arange(len(rows_T)), rows_of(self._part, covariates)
        starts = np.where(self._when.random(len(index)) < self._chance, index, -self._since)
        latest = np.maximum.accumulate(starts)
        self._since = int(len(index) - latest[-1])
        is_struck = (index - latest < self._burst)[:, None]
        rows = rows_T.copy()
        rows[:, touched] = np.where(is_struck, self._struck(rows_T[:, touched], latest), rows[:, touched])
        return rows

    def _struck(self, rows_T: FloatArray, latest: NDArray[np.intp]) -> FloatArray:
        """Return what rows (N, n) would read in a burst, if each sample's latest one began at the given index."""
        return rows_T + self._what.normal(0, self._part.values["size"], rows_T.shape)


class _Stale(_Spikes):
    """Bursts in which readings repeat the one before the burst, or come some samples late."""

    _past_T: FloatArray | None = None

    def _struck(self, rows_T: FloatArray, latest: NDArray[np.intp]) -> FloatArray:
        late = samples_in(self._part, "samples late", BLOCK)
        past = rows_T[:0] if self._past_T is None else self._past_T
        known = np.concatenate([past, rows_T])
        self._past_T = known[-max(self._burst, late) :]
        source = latest - 1 if self._part.term == "repeats" else np.arange(len(rows_T)) - late
        return np.asarray(known[np.maximum(source + len(past), 0)])


_STREAMS: dict[str, Callable[[FittedEffect, np.random.Generator], StreamedEffect]] = {
    "of_sample": _Recursive,
    "of_course": _FromThePast,
    "spikes": _Spikes,
    "repeats": _Stale,
}
"""The class for each kind of an effect that is no linear one; one of complete recordings has none."""
