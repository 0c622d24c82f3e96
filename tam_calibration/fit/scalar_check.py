"""Whether the scalar magnetometer reads the field that the sensors are in, or something beside it.

In a uniform field the intensity does not depend on how the array is turned. Where the scalar does, it is beside a
magnet, iron or a current, and the fit takes that for errors of all sensors, with small residuals. In terms of any
sensor's readings, which are an affine map of the field, every such dependence of a magnet and of soft iron is a
polynomial of second order. What slow cosines of time explain is left to the field of the site.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.noise import complete_noise
from tam_calibration.core.slow_cosines import BLOCKS, slow_cosines
from tam_calibration.fit.coverage import ellipsoid_rows
from tam_calibration.fit.posterior import Intensity
from tam_calibration.fit.slow_residuals import slow_factor
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray, to_nanotesla

_FEWEST = 10 * BLOCKS
"""Scalar readings: ten for each block of time."""

_SEEN = 1e-6
"""Part of the largest eigenvalue below which a column is the noise of the readings."""

_BEYOND = 3.72
"""Standard deviations of a normal law: once in ten thousand sound recordings."""

_MOSTLY = 0.5
"""Part of what is not slow that a magnet beside the scalar explains at least: a field that varies faster may follow the
direction in part by chance."""

_HARMLESS = 4.0
"""Squared standard errors by which the dependence moves the errors, and which are not worth losing a scalar."""


def without_turning_scalar(recording: SampleSource, array: Array) -> tuple[SampleSource, Intensity | None, str]:
    """Return the recording without a scalar that follows the direction of the field, its mean, and why; else as it is.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise.
    """
    some = recording.thinned(SKETCH)
    if some.scalar_T is None or np.count_nonzero(np.isfinite(some.scalar_T)) < _FEWEST:
        return recording, None, ""
    known = np.isfinite(some.scalar_T)
    scalar_T, field = some.scalar_T[known], some.readings_T[known].mean(axis=1)
    size_T = _turning_part(scalar_T, field / np.mean(norm(field, axis=1)), recording, array)
    if not size_T:
        return recording, None, ""
    reason = (
        f"the scalar follows the direction of the field by {to_nanotesla(size_T):.2g} nT, as beside a magnet or a "
        "current: only its mean counts; move it away, or fit its heading error"
    )
    return replace(recording.whole(), scalar_T=None), Intensity(float(scalar_T.mean()), size_T), reason


def _turning_part(scalar_T: FloatArray, field: FloatArray, recording: SampleSource, array: Array) -> float:
    """Return the size of the field that turns with the array at the scalar, tesla; 0 where it does not count."""
    count = len(scalar_T)
    block = np.arange(count) * BLOCKS // count
    slow = np.linalg.qr(np.column_stack([np.ones(count), slow_cosines()[block]]))[0]
    left_T = scalar_T - slow @ (slow.T @ scalar_T)
    rows = ellipsoid_rows(field)
    rows = rows - slow @ (slow.T @ rows)
    columns = rows @ whitening(rows.T @ rows, _SEEN)
    explained = columns.T @ left_T
    residual_T = left_T - columns @ explained
    noise_T = float(np.sqrt(np.sum(residual_T**2) / (count - columns.shape[1] - slow.shape[1])))
    edges = np.searchsorted(block, np.arange(1, BLOCKS))
    parts = list(zip(np.split(columns, edges), np.split(residual_T / noise_T, edges), strict=True))
    lasting = slow_factor(np.array([own.T @ own for own, _ in parts]), np.array([own.T @ left for own, left in parts]))
    energy = float(explained @ explained)
    if energy < _MOSTLY * float(left_T @ left_T):
        return 0.0
    # The cube root of a χ² is nearly normal (Wilson and Hilferty 1931).
    variance = 2 / 9 / len(explained)
    ratio = energy / (len(explained) * noise_T**2 * lasting)
    if np.cbrt(ratio) - 1 + variance < _BEYOND * np.sqrt(variance):
        return 0.0
    noisy, _ = complete_noise(array, recording)
    variance_T2 = noise_T**2 + 1 / float(np.sum(1 / noisy.vector_noise_T**2))
    if energy < _HARMLESS * variance_T2 * lasting:
        return 0.0
    unit = np.column_stack([slow, field / norm(field, axis=1, keepdims=True)])
    return float(norm(np.linalg.lstsq(unit, scalar_T, rcond=1e-6)[0][-3:]))
