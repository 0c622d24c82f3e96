"""How large a gap is: the energy of the channels that a model leaves out of sample, against white noise."""

from dataclasses import dataclass
from math import exp

import numpy as np

from tam_calibration.array import TENSOR_OUTPUTS
from tam_calibration.effects.effect import LinearEffect
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.gap.checks import CHANCE
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Size
from tam_calibration.gap.validation import FOLDS, held_out_energy
from tam_calibration.units import FloatArray

LEAST_NOISE = 0.5
"""White noise is no less than this part of the data sheet's where nothing tells it."""

_SURE_PART = 0.8
"""Of the variance that differences show, which is sure: their own error is some per cent."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a model leaves of each fold out of sample: energy (F,), and what noise of unit variance would leave."""

    energy: FloatArray
    noise: FloatArray

    def excess(self, variance: float) -> FloatArray:
        """Return χ²/n - 1 of each fold (F,) for channels whose noise has so many times the variance stated."""
        return self.energy / (self.noise * variance) - 1


def left_by(model: Model, interleaved: bool) -> Left:
    """Return what a model leaves out of sample; what the calibration itself costs is counted as noise."""
    base = model.base()
    energy = held_out_energy(base.channels, base.designs, [len(base.designs)], interleaved)[:, 0]
    size = base.channels.count + base.calibration_rank * FOLDS / (FOLDS - 1)
    share = size / base.channels.count
    counts = np.full(FOLDS, base.channels.count / FOLDS)
    return Left(energy, counts * share)


def is_interleaved(model: Model) -> bool:
    """Whether an accepted effect is a free function of time."""
    return any(isinstance(part.effect, LinearEffect) and part.effect.is_free_in_time for part in model.parts)


def noise_variance(model: Model, rivals: tuple[Evidence, ...], least_evidence: float) -> float:
    """Return the variance of the white noise of the channels, in units of the variance that the model's array has.

    What a rival without physics still explains is not noise, nor is what exceeds ``LARGEST_NOISE``; but never less
    than most of the floor that differences of neighbouring samples show, which no function may explain away.
    """
    base = model.base()
    gain = max((rival.gain for rival in rivals if rival.delta_bic > least_evidence), default=0.0)
    whole = base.energy / max(base.channels.count - base.rank, 1.0)
    variance = min(whole * exp(-gain / base.channels.count), LARGEST_NOISE**2)
    return float(max(variance, min(_SURE_PART * _white_part(model), whole, LARGEST_NOISE**2)))


def _white_part(model: Model) -> float:
    """Return the variance of the white noise that differences show in most rows, in that of the model's array."""
    floor = floor_of(model.channels(model.signal() if model.parts else None), model.array)
    if not floor.is_told:
        return LEAST_NOISE**2
    return float(np.median(floor.level_T[:-1] / floor.stated_T[:-1])) ** 2


def measure(nominal: Model, model: Model, variance: float) -> Size:
    """Return the size of the gap in front of the causes of a model, and with them."""
    interleaved = is_interleaved(model)
    first, last = left_by(nominal, interleaved).excess(variance), left_by(model, interleaved).excess(variance)
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
    assert model.array.vector_noise_T is not None
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
