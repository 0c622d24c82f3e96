"""Whether the scalar magnetometer reads the field that the sensors are in, or something near it.

In a uniform field the intensity does not depend on how the array is turned. Where the scalar does, it is near a
magnet, iron or a current, and the fit takes that for errors of all sensors, with small residuals. In terms of any
sensor's readings, which are an affine map of the field, every such dependence of a magnet and of soft iron is a
polynomial of second order. What slow cosines of time explain is left to the field of the site.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.noise import complete_noise
from tam_calibration.core.slow_cosines import BLOCKS, SlowSums, slow_cosines
from tam_calibration.fit.coverage import ellipsoid_rows
from tam_calibration.model.array import Array
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.units import FloatArray, to_nanotesla

FOLLOWS = "the scalar follows the direction of the field"
"""How the sentence of a scalar begins that does."""


@dataclass(frozen=True)
class TurningScalar:
    """A scalar that follows the direction of the field.

    Parameters
    ----------
    mean_T : float
        Mean of its readings, tesla.
    size_T : float
        Size of the field that turns with the array at the scalar, tesla.
    is_most : bool
        Whether that is no chance, and explains most of what the scalar reads in addition to slow changes.
    """

    mean_T: float
    size_T: float
    is_most: bool

    @property
    def sentence(self) -> str:
        """What it is and what became of it, for people."""
        counts = "so only its mean is used" if self.is_most else "and the standard errors include that"
        size = f"{to_nanotesla(self.size_T):.2g} nT"
        return f"{FOLLOWS} by {size}, as near a magnet or a current, {counts}: move it away, or fit its heading error"


def turning_scalar(recording: SampleSource, array: Array) -> TurningScalar | None:
    """Return what a scalar reads that follows the direction of the field; None where it does not.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise.
    """
    some = recording.thinned(SKETCH)
    # 10 * BLOCKS: scalar readings: ten for each block of time.
    if some.scalar_T is None or np.count_nonzero(np.isfinite(some.scalar_T)) < 10 * BLOCKS:
        return None
    known = np.isfinite(some.scalar_T)
    scalar_T, field = some.scalar_T[known], some.readings_T[known].mean(axis=1)
    size_T, is_most = _turning_part(scalar_T, field / np.mean(norm(field, axis=1)), recording, array)
    return TurningScalar(float(scalar_T.mean()), size_T, is_most) if size_T else None


def _turning_part(scalar_T: FloatArray, field: FloatArray, recording: SampleSource, array: Array) -> tuple[float, bool]:
    """Return the size of the field that turns with the array at the scalar, tesla, and whether it explains most.

    The size is 0 where it does not count.
    """
    count = len(scalar_T)
    block = np.arange(count) * BLOCKS // count
    slow = np.linalg.qr(np.column_stack([np.ones(count), slow_cosines()[block]]))[0]
    left_T = scalar_T - slow @ (slow.T @ scalar_T)
    rows = ellipsoid_rows(field)
    rows = rows - slow @ (slow.T @ rows)
    # Part of the largest eigenvalue below which a column is the noise of the readings.
    columns = rows @ whitening(rows.T @ rows, 1e-6)
    explained = columns.T @ left_T
    residual_T = left_T - columns @ explained
    noise_T = float(np.sqrt(np.sum(residual_T**2) / (count - columns.shape[1] - slow.shape[1])))
    edges = np.searchsorted(block, np.arange(1, BLOCKS))
    parts = list(zip(np.split(columns, edges), np.split(residual_T / noise_T, edges), strict=True))
    lasting = SlowSums.of(
        np.array([own.T @ own for own, _ in parts]), np.array([own.T @ left for own, left in parts])
    ).factor
    energy = float(explained @ explained)
    # The cube root of a χ² is nearly normal (Wilson and Hilferty 1931).
    variance = 2 / 9 / len(explained)
    deviation = (np.cbrt(energy / (len(explained) * noise_T**2 * lasting)) - 1 + variance) / np.sqrt(variance)
    # Standard deviations of a normal law from which standard errors hold what the dependence may do: once in a
    # hundred.
    if deviation < 2.33:
        return 0.0, False
    noisy, _ = complete_noise(array, recording)
    variance_T2 = noise_T**2 + 1 / float(np.sum(1 / noisy.vector_noise_T**2))
    # Squared standard errors by which the dependence moves the errors, and which are not worth losing a scalar.
    is_harmful = energy > 4.0 * variance_T2 * lasting
    unit = np.column_stack([slow, field / norm(field, axis=1, keepdims=True)])
    size_T = float(norm(np.linalg.lstsq(unit, scalar_T, rcond=1e-6)[0][-3:]))
    # Standard deviations of a normal law: once in ten thousand sound recordings.
    # Part of what is not slow that a magnet near the scalar explains at least: a field that varies faster may
    # follow the direction in part by chance.
    return size_T, bool(deviation > 3.72 and is_harmful and energy >= 0.5 * float(left_T @ left_T))
