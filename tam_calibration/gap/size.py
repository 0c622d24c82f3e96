"""The size of a gap: the residual energy of held-out samples, compared with white noise."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp

import numpy as np

from tam_calibration.core.normal_equations import Normal
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.effects.grades import CERTAIN
from tam_calibration.gap.checks import CHANCE
from tam_calibration.gap.evidence import Evidence
from tam_calibration.gap.floor import floor_of, white_variance
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import VISIBLE, pseudo_inverse
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Size
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import TENSOR_OUTPUTS
from tam_calibration.model.units import FloatArray

FOLDS = 5
"""Folds of the cross-validation: four fifths of a recording determine nearly as much as all of it."""

_BLOCKS_PER_FOLD = 12
"""Blocks of time in a fold, so that no fold holds all samples of an attitude."""


def folds_of(sample_count: int, interleaved: bool) -> list[list[slice]]:
    """Return the samples of each fold: blocks of time, or every fifth sample for free functions of time.

    Parameters
    ----------
    sample_count : int
        Number of samples of the recording, or of those that the fit takes.
    interleaved : bool
        Whether to take every fifth sample.

    Returns
    -------
    list of list of slice
        Of each of the five folds the slices that it consists of.
    """
    if interleaved:
        return [[slice(fold, sample_count, FOLDS)] for fold in range(FOLDS)]
    bounds = np.linspace(0, sample_count, FOLDS * _BLOCKS_PER_FOLD + 1).astype(int).tolist()
    blocks = [slice(low, high) for low, high in pairwise(bounds)]
    return [blocks[fold::FOLDS] for fold in range(FOLDS)]


def held_out_energy(
    channels: WhitenedChannels, designs: Sequence[Regressors], widths: Sequence[int], interleaved: bool
) -> FloatArray:
    """Return the energy (F, M) of each fold under fits of M nested models to the other folds.

    Parameters
    ----------
    channels : WhitenedChannels
        Whitened channels.
    designs : sequence of Regressors
        Of the calibration, then of effects.
    widths : sequence of int
        How many of the designs each of M models has.
    interleaved : bool
        See ``folds_of``.
    """
    joined = Regressors.joined(designs)
    ends = np.cumsum([design.width for design in designs])
    parts = []
    for fold in folds_of(len(channels.intensity_residual_T), interleaved):
        blocks = [channels.normal(joined, block) for block in fold]
        parts.append(sum(blocks[1:], start=blocks[0]))
    whole = sum(parts[1:], start=parts[0])
    energy = np.empty((len(parts), len(widths)))
    for row, part in enumerate(parts):
        train = whole - part
        for column, width in enumerate(widths):
            energy[row, column] = _energy(train, part, int(ends[width - 1]))
    return energy


def _energy(train: Normal, test: Normal, width: int) -> float:
    """Return the energy of the test samples under the fit of the first columns to the training samples."""
    first = slice(0, width)
    step = pseudo_inverse(train.information[first, first], VISIBLE) @ train.score[first]
    return float(test.energy - 2 * step @ test.score[first] + step @ test.information[first, first] @ step)


LEAST_NOISE = 0.5
"""Least white noise, as a part of that stated, where differences do not determine it."""

_CERTAIN_PART = 0.8
"""Part of the variance from differences that is certainly noise: the estimate is uncertain by some per cent."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Residual energy (F,) of each held-out fold, and that expected of noise of unit variance."""

    energy: FloatArray
    noise: FloatArray

    def excess(self, variance: float) -> FloatArray:
        """Return χ²/n - 1 of each fold (F,), for noise of so many times the variance stated."""
        return self.energy / (self.noise * variance) - 1


def held_out(model: Model, interleaved: bool) -> HeldOut:
    """Return the residual energy of a model out of sample; the variance of the calibration itself counts as noise.

    Parameters
    ----------
    model : Model
        Fitted to all samples that count.
    interleaved : bool
        See ``folds_of``.
    """
    base = model.base()
    energy = held_out_energy(base.channels, base.designs, [len(base.designs)], interleaved)[:, 0]
    size = base.channels.count + base.calibration_rank * FOLDS / (FOLDS - 1)
    share = size / base.channels.count
    counts = np.full(FOLDS, base.channels.count / FOLDS)
    return HeldOut(energy, counts * share)


def is_interleaved(model: Model) -> bool:
    """Whether an accepted effect is a free function of time."""
    return any(isinstance(part.effect, LinearEffect) and part.effect.is_free_in_time for part in model.parts)


def noise_variance(model: Model, rivals: tuple[Evidence, ...], least_evidence: float) -> float:
    """Return the variance of the white noise of the channels, in units of the variance that the model's array has.

    The residual variance less what a rival without physics still explains, at most ``LARGEST_NOISE``² and at least
    most of the floor from differences of neighbouring samples, which no function may explain away.

    Parameters
    ----------
    model : Model
        With the causes.
    rivals : tuple of Evidence
        Functions without physics in the residual of this model.
    least_evidence : float
        ΔBIC from which a rival counts.
    """
    base = model.base()
    gain = max((rival.gain for rival in rivals if rival.delta_bic > least_evidence), default=0.0)
    residual = base.energy / max(base.channels.count - base.rank, 1.0)
    variance = min(residual * exp(-gain / base.channels.count), LARGEST_NOISE**2)
    return float(max(variance, min(_CERTAIN_PART * _white_part(model), residual, LARGEST_NOISE**2)))


def certain_noise(channels: WhitenedChannels) -> float:
    """Return the energy that no regression explains: the white noise, but for what it may be estimated too large.

    Parameters
    ----------
    channels : WhitenedChannels
        Of a model; more noise than the model's array has is not taken for certain.
    """
    has_reference = channels.is_counted & (channels.precision > 0)
    common = (np.sqrt(channels.precision) * channels.intensity_residual_T)[has_reference, None]
    energy = 0.0
    for series in (channels.differential[channels.is_counted], common):
        variance, error = white_variance(series)
        energy += series.size * min(max(variance - CERTAIN * error, 0.0), 1.0)
    return energy / channels.stride


def _white_part(model: Model) -> float:
    """Return the variance of white noise from differences, the median of the rows, over that of the model's array."""
    floor = floor_of(model.channels(model.signal() if model.parts else None), model.array)
    if not floor.is_determined:
        return LEAST_NOISE**2
    return float(np.median(floor.level_T[:-1] / floor.stated_T[:-1])) ** 2


def measure(nominal: Model, model: Model, variance: float) -> Size:
    """Return the size of the gap before the causes of a model, and with them.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    interleaved = is_interleaved(model)
    first, last = held_out(nominal, interleaved).excess(variance), held_out(model, interleaved).excess(variance)
    before, after = float(np.sqrt(max(first.mean(), 0))), float(np.sqrt(max(last.mean(), 0)))
    closed, interval = _closed(first, last)
    floor = float(np.sqrt(variance * np.mean(model.row_noise_T**2)))
    tensors = [_tensor_excess(one, variance) for one in (nominal, model)]
    return Size(before, after, before * floor, after * floor, tensors[0], tensors[1], floor, closed, interval)


def _closed(first: FloatArray, last: FloatArray) -> tuple[float, tuple[float, float]]:
    from scipy.special import stdtrit

    def part(kept: np.ndarray) -> float:
        total = first[kept].mean()
        return float(np.clip(1 - max(last[kept].mean(), 0) / total, 0, 1)) if total > 0 else 0.0

    everything = np.ones(len(first), dtype=bool)
    value = part(everything)
    left_out = np.array([part(np.arange(len(first)) != fold) for fold in range(len(first))])
    error = np.sqrt((len(first) - 1) / len(first) * np.sum((left_out - left_out.mean()) ** 2))
    # Student's t has as many degrees of freedom as there are folds less one.
    half = float(stdtrit(len(first) - 1, 1 - CHANCE / 2) * error)
    return value, (max(value - half, 0.0), min(value + half, 1.0))


def _tensor_excess(model: Model, variance: float) -> float:
    """Return the root of the summed squares of the tensor's components beyond noise, T/m."""
    if not model.array.has_gradient:
        return float("nan")
    counted = model.is_counted
    readings = model.recording.readings_T
    if model.parts:
        readings = readings - model.signal()[:, :-1].reshape(readings.shape)
    restored = model.errors.restore(readings[counted]).reshape(int(counted.sum()), -1)
    tensor = restored @ model.array.operator[list(TENSOR_OUTPUTS)].T
    unmixed = np.einsum(
        "rki,kij->rkj", model.array.operator[list(TENSOR_OUTPUTS)].reshape(5, -1, 3), np.linalg.inv(model.errors.matrix)
    ).reshape(5, -1)
    noise = variance * unmixed**2 @ np.repeat(model.array.vector_noise_T**2, 3)
    return float(np.sqrt(max(np.sum(np.mean(tensor**2, axis=0)) - noise.sum(), 0.0)))
