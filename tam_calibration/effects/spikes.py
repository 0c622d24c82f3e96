"""Isolated outliers: samples so far off that noise does not explain them, and their neighbours are not."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.grades import LONGEST_BURST, MINOR
from tam_calibration.effects.term import WhitenedResiduals, row_deviations

A_DOZEN = 12
"""Single readings that are no noise, whatever part of a short recording they are: a sixth of 72 poses."""

_FAR = 5.0
"""Standard deviations from which a row is far off: one of a million values of white noise is."""

_BLOCK = 50
"""Samples of a block, of which the median tells the local noise."""


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
    deviation = np.abs(row_deviations(residuals)) * usable[:, None]
    # The row that explains most, not the largest residual: noise of one row affects all.
    worst = deviation.argmax(axis=1)
    blocks = max(len(worst) // _BLOCK, 1)
    local = noise_deviation(deviation[: blocks * _BLOCK].reshape(blocks, -1, deviation.shape[1]), axis=1)
    samples = np.arange(len(worst))
    scale = np.maximum(local[np.minimum(samples // _BLOCK, blocks - 1), worst], 1.0)
    far = deviation[samples, worst] > _FAR * scale
    far &= _run_lengths(far) <= LONGEST_BURST
    if not far.any():
        return f"no reading is far off for at most {LONGEST_BURST} samples"
    if far.sum() > max(MINOR * usable.sum(), A_DOZEN):
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    return Spikes(np.flatnonzero(far), worst[far])


def without_spikes(residuals: WhitenedResiduals) -> WhitenedResiduals:
    """Return a residual in which the samples of isolated outliers do not count."""
    spikes = find_spikes(residuals)
    if isinstance(spikes, str):
        return residuals
    is_counted = residuals.is_counted.copy()
    is_counted[spikes.samples] = False
    return replace(residuals, is_counted=is_counted)


def _run_lengths(chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the length of the unbroken run of chosen samples that each sample is in, 0 outside."""
    edges = np.flatnonzero(np.diff(chosen.astype(np.int8), prepend=0, append=0))
    lengths = np.zeros(len(chosen), dtype=np.intp)
    for start, stop in edges.reshape(-1, 2):
        lengths[start:stop] = stop - start
    return lengths
