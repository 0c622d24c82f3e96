"""The noise of sensors: robust scales, and a noise that is not stated, from the recording's fast differences."""

import numpy as np

from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray


def noise_deviation(values: FloatArray, axis: int | None = None) -> FloatArray:
    """Return the standard deviation of normal noise whose absolute values have the same median, along an axis.

    Parameters
    ----------
    values : array
        Noise about zero, in any shape and unit.
    axis : int, optional
        Along which the median is taken; by default over all values.
    """
    from scipy.special import ndtri

    return np.asarray(np.median(np.abs(values), axis=axis) / ndtri(0.75))


def noise_energy(energy: FloatArray, freedom: int) -> float:
    """Return the variance of normal noise whose sums of squares have the same median as given ones.

    Parameters
    ----------
    energy : (N,) array
        Sums of squares.
    freedom : int
        Number of squares in each sum.
    """
    from scipy.special import chdtri

    return float(np.median(energy) / chdtri(freedom, 0.5))


_SMALLEST_T = 1e-12
"""A picotesla, where readings do not change at all: no noise is zero."""


def complete_noise(array: Array, source: SampleSource) -> tuple[KnownNoiseArray, bool]:
    """Return the array with every noise known, and whether one was estimated.

    A noise that is not stated is the robust scale of the third differences of its channel divided by √20, which is
    exact for white noise on a motion that is slow against the sampling. Attitudes that jump would pass for noise, so
    that no more than a fiftieth of the readings' spread is taken; the fit then scales it to the residual. A stated
    noise is kept. Of a recording of more than 100 000 samples some stretches serve.

    Parameters
    ----------
    array : Array
        Its noise stated or not.
    source : SampleSource
        Raw readings of its K sensors, tesla.
    """
    needs_scalar = array.scalar_noise_T is None and source.scalar_count is not None
    estimated = array.vector_noise_T is None or needs_scalar
    vector, scalar = array.vector_noise_T, 0.0 if array.scalar_noise_T is None else array.scalar_noise_T
    if estimated:
        readings, reference = _stretches(source)
    if vector is None:
        fast = np.sqrt(np.mean(fast_noise(readings) ** 2, axis=1))
        spread = readings.std(axis=0).mean(axis=1)
        # Of the readings' spread, which attitudes that jump would pass for noise; 1000 nT in the Earth's field.
        vector = np.minimum(fast, np.maximum(0.02 * spread, _SMALLEST_T))
    if needs_scalar and len(reference) > 3:
        scalar = float(fast_noise(reference[:, None])[0])
    return array.with_noise(vector, scalar), estimated


def _stretches(source: SampleSource) -> tuple[FloatArray, FloatArray]:
    """Return readings (n, K, 3) and the scalar readings there are, of blocks spread over the recording."""
    stride = -(-source.sample_count // SKETCH)
    chosen = [block for index, block in enumerate(source.blocks()) if index % stride == 0]
    scalar = np.concatenate([block.scalar_T for block in chosen if block.scalar_T is not None] or [np.empty(0)])
    return np.concatenate([block.readings_T for block in chosen]), scalar[np.isfinite(scalar)]


def fast_noise(values: FloatArray) -> FloatArray:
    """Return the robust standard deviation of the white noise along the first axis."""
    difference = np.diff(values, n=min(3, len(values) - 1), axis=0)
    # np.sqrt(20.0): of the weights 1, 3, 3, 1: by so much white noise grows in third differences.
    spread = noise_deviation(difference, axis=0) / np.sqrt(20.0)
    return np.asarray(np.maximum(spread, _SMALLEST_T))
