"""What the cases of the localisation benchmark have in common: Wu's set-up of section 4.2, and how errors are told."""

import numpy as np
from asked import Figure
from numpy.linalg import norm
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.sources.dipole import Dipole, Loop
from tam_validation.papers.wu2025_coil import AMPERE_TURNS, HEADINGS_DEG, POSITION_M, RADIUS_M

AMPLITUDE_NOISE_T = from_nanotesla(0.05)
"""Of the amplitude of an alternating field, which is the mean of many samples."""
SENSOR_NOISE_T = from_nanotesla(1.0)
"""Of one sample, as in the scenarios of this package."""
RANGE_M = float(norm(POSITION_M))
MOMENT_AM2 = AMPERE_TURNS * np.pi * RADIUS_M**2
ARRAY = Array.cross(0.21, vector_noise_T=AMPLITUDE_NOISE_T)
"""The cross of that set-up."""
POSES = Rotation.from_euler("z", from_degrees(HEADINGS_DEG)[:, None])


def directions(generator: np.random.Generator, count: int) -> FloatArray:
    """Return (count, 3) random directions."""
    drawn = generator.standard_normal((count, 3))
    unit: FloatArray = drawn / norm(drawn, axis=1, keepdims=True)
    return unit


def in_array(source: Dipole | Loop) -> FloatArray:
    """Return the (12, 4, 3) fields at the sensors in the array frame."""
    turn = POSES.as_matrix()
    fields: FloatArray = np.einsum(
        "nji,nkj->nki", turn, source.field_T(np.einsum("nij,kj->nki", turn, ARRAY.positions_m))
    )
    return fields


def ratio(case: str, method: str, name: str, squares: object, asked: tuple[float, float]) -> Figure:
    """Return the root of mean squared ratios with its standard error."""
    each = np.asarray(squares, dtype=float)
    each = each.reshape(len(each), -1).mean(axis=1)
    root = float(np.sqrt(each.mean()))
    return Figure(case, method, name, root, float(each.std(ddof=1) / np.sqrt(len(each)) / (2 * root)), asked)


def largest(errors: object) -> float:
    """Return the largest size of errors of the distance over the range."""
    return float(np.abs(np.asarray(errors)).max()) / RANGE_M


def rms(errors: object) -> float:
    """Return the root mean square of errors."""
    return float(np.sqrt(np.mean(np.square(np.asarray(errors)))))
