"""Isolated outliers: samples so far off that neither noise nor a cause of another kind explains them.

A reading is flagged where a shift of its row alone lies beyond what noise reaches in so many readings: the tail of
Student's distribution for a scale from the median (whose efficiency of 37 % gives the degrees of freedom), with the
false discovery rate of Benjamini and Hochberg (1995). The scale is the larger of the record's and that of the
surroundings, so that a noisy axis or interval has no outliers. Excluded are deviations longer than a burst, those that
neighbours in time or on the sphere share, those in noisier surroundings, and readings at the end of an axis' range:
these have causes of their own.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.grades import CERTAIN, LEAST_SAMPLES, LONGEST_BURST, MINOR, NEGLIGIBLE, NOTABLE
from tam_calibration.effects.motion import MOST_NEIGHBOURS
from tam_calibration.effects.saturation import find_limits
from tam_calibration.effects.term import WhitenedResiduals, row_deviations
from tam_calibration.model.units import FloatArray

_EFFICIENCY = 0.37
"""Efficiency of the median absolute value as an estimate of a Gaussian scale."""

A_DOZEN = 12
"""Single readings that are no noise, whatever part of a short recording they are: a sixth of 72 poses."""

_BLOCK = 200
"""Samples over which the local scale is estimated."""

_IN_TIME = slice(LEAST_SAMPLES - LONGEST_BURST // 2, LEAST_SAMPLES + LONGEST_BURST // 2)
"""Of the samples around a spike, those next to it."""

_BESIDE = 10
"""Samples on either side of a spike in which the local noise is compared."""


@dataclass(frozen=True, eq=False)
class Spikes:
    """Isolated outliers.

    Parameters
    ----------
    samples : (k,) array of int
        Their indices.
    rows : (k,) array of int
        The row that explains most of each.
    """

    samples: NDArray[np.intp]
    rows: NDArray[np.intp]


def find_spikes(residuals: WhitenedResiduals) -> Spikes | str:
    """Return the isolated outliers, or why there are none, in one clause."""
    usable = residuals.channel_count > 0
    for limit in find_limits(residuals):
        usable[limit.samples] = False
    if usable.sum() < 2 * LONGEST_BURST:
        return "there are too few samples to tell a spike from noise"
    raw = row_deviations(residuals)
    deviation = _standardised(raw, usable)
    # The row that explains most, not the largest residual: noise of one row affects all.
    worst = np.argmax(np.abs(raw), axis=1)
    height = np.abs(deviation[np.arange(len(worst)), worst]) * usable
    chance = _chance(height, int(usable.sum()), deviation.shape[1])
    far = _improbable(chance)
    if not far.any():
        return "no reading lies beyond what noise reaches"
    if far.sum() > max(MINOR * usable.sum(), A_DOZEN):
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    bursts = _bursts(height > CERTAIN)
    far &= bursts <= LONGEST_BURST
    if not far.any():
        return f"what is far off lasts longer than {LONGEST_BURST} samples"
    far[_shared(residuals, deviation, worst, far)] = False
    if not far.any():
        return "what is far off is so at neighbouring times or directions of the field as well"
    far = _improbable(np.where(far, chance, 1.0))
    if not far.any():
        return "no reading lies beyond what noise reaches"
    if _is_loud_around(deviation, worst, far, usable):
        return "what is far off comes in spells, as where the noise changes"
    samples = np.flatnonzero(far)
    return Spikes(samples, worst[samples])


def come_with_motion(residuals: WhitenedResiduals, spikes: Spikes) -> bool:
    """Whether spikes occur where the expected reading of their rows changes fastest, or where it is constant.

    By Fisher's method: the sum of the logarithms of the parts of the record in which a row changes as much, or as
    little. A single spike may show the former, only several the latter.

    Parameters
    ----------
    residuals : WhitenedResiduals
        In which the spikes were found.
    spikes : Spikes
        Their samples, and the row of each.
    """
    from scipy.special import chdtrc, ndtr

    sensed, parts = residuals.covariates.sensed_T, list[tuple[float, float]]()
    for row in np.unique(spikes.rows[spikes.rows < residuals.covariates.scalar_row]):
        struck = spikes.samples[spikes.rows == row]
        for burst in np.split(struck, np.flatnonzero(np.diff(struck) > 1) + 1):
            before, after = burst[0] - 1, burst[-1] + 1
            if before >= 0 and after < len(sensed):
                # Of the samples beside it, as the spike is in the field that all sensors agree on.
                across = np.abs(sensed[after - before :, row] - sensed[: before - after, row])
                parts.append((float(np.mean(across >= across[before])), float(np.mean(across <= across[before]))))
    if not parts:
        return False
    fastest, slowest = chdtrc(2 * len(parts), -2 * np.log(parts).sum(axis=0))
    return bool(fastest < NEGLIGIBLE or slowest < ndtr(-CERTAIN))


def without_spikes(residuals: WhitenedResiduals, of_motion: bool = False) -> WhitenedResiduals:
    """Return a residual in which isolated outliers do not count; on wish only where they occur with the motion."""
    spikes = find_spikes(residuals)
    if isinstance(spikes, str) or (of_motion and not come_with_motion(residuals, spikes)):
        return residuals
    is_counted = residuals.is_counted.copy()
    is_counted[spikes.samples] = False
    return replace(residuals, is_counted=is_counted)


def _standardised(raw: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Return the deviation of each row in units of the larger of the record's scale and that of the surroundings."""
    deviation = np.where(usable[:, None], raw, 0)
    chosen = np.abs(deviation[usable])
    count = max(1, len(chosen) // _BLOCK)
    size = len(chosen) // count
    blocks = chosen[: count * size].reshape(count, size, -1)
    scale = noise_deviation(blocks, axis=1)
    thinned = chosen[:: max(1, len(chosen) // MOST_NEIGHBOURS)]
    scale = np.maximum(scale, noise_deviation(thinned, axis=0))
    index = np.zeros(len(deviation), dtype=np.intp)
    index[usable] = np.minimum(np.arange(len(chosen)) // size, count - 1)
    scale = np.where(scale > 0, scale, np.inf)
    return deviation / scale[index]


def _chance(height: FloatArray, count: int, row_count: int) -> FloatArray:
    """Return the probability that noise makes the largest of a sample's deviations so large."""
    from scipy.special import stdtr

    freedom = _EFFICIENCY * min(count, _BLOCK)
    return np.asarray(np.minimum(1.0, 2 * row_count * stdtr(freedom, -height)))


def _improbable(chance: FloatArray) -> NDArray[np.bool_]:
    """Return the samples that are improbable, by the false discovery rate among all."""
    ordered = np.sort(chance)
    allowed = np.flatnonzero(ordered <= NEGLIGIBLE * np.arange(1, len(chance) + 1) / len(chance))
    return chance <= (ordered[allowed[-1]] if len(allowed) else -1.0)


def _bursts(hot: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the length of the unbroken run of hot samples that each sample is in, 0 outside."""
    edges = np.flatnonzero(np.diff(hot.astype(np.int8), prepend=0, append=0))
    lengths = np.zeros(len(hot), dtype=np.intp)
    for start, stop in edges.reshape(-1, 2):
        lengths[start:stop] = stop - start
    return lengths


def _shared(
    residuals: WhitenedResiduals, deviation: FloatArray, worst: NDArray[np.intp], far: NDArray[np.bool_]
) -> NDArray[np.intp]:
    """Return the samples that neighbours in time or direction of the field equal, or whose surroundings are noisy."""
    from scipy.spatial import cKDTree

    others, samples = np.flatnonzero(~far & (residuals.channel_count > 0)), np.flatnonzero(far)
    if len(others) < 4 * LONGEST_BURST:
        return samples[:0]
    rows = worst[samples][:, None]
    own = deviation[samples, rows[:, 0]]
    order = np.searchsorted(others, samples)[:, None]
    around = others[np.clip(order + np.arange(-LEAST_SAMPLES, LEAST_SAMPLES), 0, len(others) - 1)]
    shared = np.median(deviation[around[:, _IN_TIME], rows], axis=1) / own > NOTABLE
    usable = np.flatnonzero(residuals.channel_count > 0)
    thinned = usable[:: max(1, len(usable) // MOST_NEIGHBOURS)]
    direction = residuals.covariates.field_T / residuals.covariates.intensity_T[:, None]
    near = thinned[cKDTree(direction[thinned]).query(direction[samples], LONGEST_BURST)[1]]
    at_direction = np.where(np.abs(near - samples[:, None]) > LONGEST_BURST, deviation[near, rows], np.nan)
    several = np.sum(np.isfinite(at_direction), axis=1) >= LONGEST_BURST // 2
    shared[several] |= np.nanmedian(at_direction[several], axis=1) / own[several] > NOTABLE
    sides = deviation[around, rows].reshape(len(samples), 2, LEAST_SAMPLES)
    shared |= np.abs(own) < CERTAIN * noise_deviation(sides, axis=2).max(axis=1)
    return np.asarray(samples[shared])


def _is_loud_around(
    deviation: FloatArray, worst: NDArray[np.intp], far: NDArray[np.bool_], usable: NDArray[np.bool_]
) -> bool:
    """Return whether the samples beside those that are far off scatter more than the others of the same rows."""
    others, samples = np.flatnonzero(~far & usable), np.flatnonzero(far)
    steps = np.concatenate([np.arange(-_BESIDE, 0), np.arange(_BESIDE)])
    beside = others[np.clip(np.searchsorted(others, samples)[:, None] + steps, 0, len(others) - 1)]
    scale = float(noise_deviation(deviation[beside, worst[samples][:, None]]))
    return scale > 1 + NOTABLE + CERTAIN / float(np.sqrt(2 * _EFFICIENCY * beside.size))
