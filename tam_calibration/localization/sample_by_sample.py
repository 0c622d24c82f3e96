"""The source of each sample of a run by itself: what the localizer node and `tam locate` have in common."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.finite_baseline import locate_with_baselines
from tam_calibration.localization.line_fit import CURRENT_INDEX, DIPOLES_INDEX
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.turned_samples import locate_turned
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

_TENTHS = 10
"""Parts of a run whose medians tell how certain the regional field is."""

_TO_DEVIATION = 1.4826
"""Standard deviation of normal numbers over their median absolute deviation."""

SOURCES = {CURRENT_INDEX: "line of current", DIPOLES_INDEX: "line of dipoles", DIPOLE_INDEX: "dipole"}


@dataclass(frozen=True, eq=False)
class Regional:
    """The field beside that of the source, uniform in the world of the attitude.

    Parameters
    ----------
    field_T : (3,) array
        In the world, tesla.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    covariance_T2 : (3, 3) array, optional
        Of the field, T²; without it the field is exact.
    """

    field_T: FloatArray
    attitude_noise: float = 0.0
    covariance_T2: FloatArray | None = None


def regional_of(outputs: FloatArray, attitude: FloatArray, attitude_noise: float = 0.0) -> Regional:
    """Return the field that most samples have in the world: the median of each of its components.

    Its standard error is by how much the medians of tenths of the samples differ, median absolute deviation times
    1.48: less by what noise has, and more by the tail of the source and a gradient, which no longer run makes smaller.

    Parameters
    ----------
    outputs : (N, 9) or (N, 8) array
        Field and gradient, most of them far from the source.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.

    Raises
    ------
    InputError
        When no sample has a field and an attitude.
    """
    from scipy.spatial.transform import Rotation

    known = np.isfinite(outputs[:, :3]).all(axis=1) & np.isfinite(attitude).all(axis=1)
    if not known.any():
        raise InputError("no sample has a field and an attitude: the regional field cannot be fitted")
    world = Rotation.from_quat(attitude[known]).apply(outputs[known, :3])
    # Errors of the attitude shorten the median of each component by half of what they shorten its mean.
    field = np.median(world, axis=0) / (1 - attitude_noise**2 / 2)
    tenths = np.array([np.median(part, axis=0) for part in np.array_split(world, _TENTHS) if len(part)])
    spread = _TO_DEVIATION * np.median(np.abs(tenths - np.median(tenths, axis=0)), axis=0)
    return Regional(field, attitude_noise, np.diag(spread**2))


def locate_samples(
    outputs: FloatArray,
    array: Array,
    covariance: FloatArray,
    *,
    index: float = DIPOLE_INDEX,
    regional: Regional | None = None,
    attitude: FloatArray | None = None,
) -> EulerSolutions:
    """Locate the source of each sample; a sample's result does not depend on its neighbours.

    It is located with the array's true baselines.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) array
        Of the outputs; without a regional field it may be (N, 9, 9), one for each sample.
    index : float
        Structural index.
    regional : Regional, optional
        What is taken off the field; without it the outputs are those of the source alone.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world, needed where there is a regional field; NaN where
        unknown, which refuses the sample.

    Returns
    -------
    EulerSolutions
        In the array frame.

    Raises
    ------
    InputError
        When a shape or the structural index is wrong, the covariance is none, or there is no attitude.
    """
    if not array.has_gradient:
        return EulerSolutions.refused(len(outputs), Status.NOT_FINITE)
    if regional is None:
        return locate_with_baselines(outputs, array, covariance, index=index)
    if attitude is None:
        raise InputError("without an attitude the regional field cannot be taken off")
    matrices = matrices_of(attitude)
    field_T = np.einsum("nji,j->ni", matrices, regional.field_T)
    spread = np.zeros((3, 3)) if regional.covariance_T2 is None else regional.covariance_T2
    own = np.swapaxes(matrices, 1, 2) @ spread @ matrices
    if regional.attitude_noise or regional.covariance_T2 is not None:
        solutions = locate_turned(outputs, field_T, array, covariance, own, regional.attitude_noise, index)
    else:
        source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
        solutions = locate_with_baselines(source, array, covariance, index=index)
    return _unless_unknown(solutions, attitude)


def turned(solutions: EulerSolutions, attitude: FloatArray, attitude_noise: float = 0.0) -> EulerSolutions:
    """Return solutions of the array frame along the axes of the world, the array's centre still the origin.

    An error of the attitude turns place and moment too.

    Parameters
    ----------
    solutions : EulerSolutions
        In the array frame.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world; where one is unknown so is the result.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """
    matrix, variance = matrices_of(attitude), attitude_noise**2
    back = np.swapaxes(matrix, 1, 2)
    world = EulerSolutions(
        (matrix @ solutions.position_m[..., None])[..., 0],
        matrix @ _turning(solutions.position_covariance_m2, solutions.position_m, variance) @ back,
        (matrix @ solutions.moment_Am2[..., None])[..., 0],
        matrix @ _turning(solutions.moment_covariance_A2m4, solutions.moment_Am2, variance) @ back,
        solutions.status,
        solutions.chi_square,
        (matrix @ solutions.along[..., None])[..., 0],
        matrix @ _turning(solutions.along_covariance, solutions.along, variance) @ back,
    )
    return _unless_unknown(world, attitude)


def _turning(covariance: FloatArray, vectors: FloatArray, variance: float) -> FloatArray:
    """Add to the covariances (N, 3, 3) of vectors (N, 3) what turns of a variance about each axis make of them."""
    along = vectors[:, :, None] * vectors[:, None, :]
    size = np.einsum("ni,ni->n", vectors, vectors)[:, None, None]
    widened: FloatArray = covariance + variance * (size * np.eye(3) - along)
    return widened


def _unless_unknown(solutions: EulerSolutions, attitude: FloatArray) -> EulerSolutions:
    """Name the attitude as the reason where it is unknown."""
    status = np.where(np.isfinite(attitude).all(axis=1), solutions.status, Status.NO_ATTITUDE)
    return replace(solutions, status=status)


def matrices_of(attitude: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) of quaternions (N, 4), NaN where they are unknown."""
    from scipy.spatial.transform import Rotation

    known = np.isfinite(attitude).all(axis=1)
    matrices = np.full((len(attitude), 3, 3), np.nan)
    if known.any():
        matrices[known] = Rotation.from_quat(attitude[known]).as_matrix()
    return matrices
