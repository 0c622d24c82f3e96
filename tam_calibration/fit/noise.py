"""The noise of sensors that is not stated, from the recording's fast differences."""

from dataclasses import replace

import numpy as np

from tam_calibration.array import Array
from tam_calibration.recording import Recording
from tam_calibration.units import FloatArray

_MEDIAN_ABSOLUTE_OF_NORMAL = 0.6744897501960817
_THIRD_DIFFERENCE_NORM = np.sqrt(20.0)
_SMALLEST_T = 1e-12
_LARGEST_PART_OF_SPREAD = 0.02


def complete_noise(array: Array, recording: Recording) -> tuple[Array, bool]:
    """Return the array with every noise known, and whether one was estimated.

    A noise that is not stated is the robust scale of the third differences of its channel divided by √20, which is
    exact for white noise on a motion that is slow against the sampling. Attitudes that jump would pass for noise, so
    that no more than a fiftieth of the readings' spread is taken; the fit then scales it to the residual. A stated
    noise is kept.
    """
    estimated = array.vector_noise_T is None or (array.scalar_noise_T is None and recording.scalar_T is not None)
    vector, scalar = array.vector_noise_T, array.scalar_noise_T
    if vector is None:
        fast = np.sqrt(np.mean(_fast_noise(recording.readings_T) ** 2, axis=1))
        spread = recording.readings_T.std(axis=0).mean(axis=1)
        vector = np.minimum(fast, np.maximum(_LARGEST_PART_OF_SPREAD * spread, _SMALLEST_T))
    if scalar is None:
        known = np.empty(0) if recording.scalar_T is None else recording.scalar_T[np.isfinite(recording.scalar_T)]
        scalar = float(_fast_noise(known[:, None])[0]) if len(known) > 3 else 0.0
    return replace(array, vector_noise_T=vector, scalar_noise_T=scalar), estimated


def _fast_noise(values: FloatArray) -> FloatArray:
    """Return the robust standard deviation of the white noise along the first axis."""
    difference = np.diff(values, n=min(3, len(values) - 1), axis=0)
    spread = np.median(np.abs(difference), axis=0) / (_MEDIAN_ABSOLUTE_OF_NORMAL * _THIRD_DIFFERENCE_NORM)
    noise: FloatArray = np.maximum(spread, _SMALLEST_T)
    return noise
