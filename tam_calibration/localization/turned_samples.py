"""The source of each sample of a run by itself: what the localizer node and `tam locate` have in common.

The regional field beside it is uncertain, or known but for a turn.
An error of the attitude of 0.1° turns 87 nT of 50 µT across the field, and a regional field that was fitted to the run
is uncertain by tens of nT: more than most sources make. What is left is the gradient and a component or two, six
numbers or seven for six unknowns: nearly, these have several solutions. So fits begin from several fields where the
dipole's is not far above what is uncertain. A sample that two different dipoles explain is refused as ambiguous.

A turn moves the regional field f to another of the same length, g: what the dipole leaves of the reading. About g the
covariance is σ² (|g|² - g gᵀ), and along g the reading less f has |f| - fᵀg/|g| beside the dipole. The field of the
dipole itself is not turned: its place and moment are sought in the axes of the array.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.calibration_errors import PLACE_ERROR_M, places_of
from tam_calibration.localization.euler import (
    DIPOLE_INDEX,
    fit_outputs,
    is_certain,
    locate,
    locate_with_baselines,
    start_of,
)
from tam_calibration.localization.line_fit import CURRENT_INDEX, DIPOLES_INDEX, unknowns_of
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.model.array import Array, tensors_of
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

    It is located with the array's true baselines. Where the source leaves too much of the outputs, the places of the
    sensors are taken for uncertain; where it still does, the sample is refused.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) or (N, 9, 9) array
        Of the outputs, for all samples or each.
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
    found = locate_each(outputs, array, covariance, index=index, regional=regional, attitude=attitude)
    freedom = 8 - unknowns_of(index)
    at = found.misfits(freedom)
    if not len(at):
        return found
    by_places = PLACE_ERROR_M * array.operator @ places_of(tensors_of(outputs[at]), array.sensor_count)
    widened = (covariance if covariance.ndim == 2 else covariance[at]) + by_places @ np.swapaxes(by_places, 1, 2)
    own = None if attitude is None else attitude[at]
    again = locate_each(outputs[at], array, widened, index=index, regional=regional, attitude=own)
    return found.put(at, again.tested(freedom))


def locate_each(
    outputs: FloatArray,
    array: Array,
    covariance: FloatArray,
    *,
    index: float = DIPOLE_INDEX,
    regional: Regional | None = None,
    attitude: FloatArray | None = None,
) -> EulerSolutions:
    """Do the same, whatever the source leaves: see ``EulerSolutions.chi_square``."""
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
    )
    return _unless_unknown(world, attitude)


def _turning(covariance: FloatArray, vectors: FloatArray, variance: float) -> FloatArray:
    """Add to the covariances (N, 3, 3) of vectors (N, 3) what turns of a variance about each axis make of them."""
    along = vectors[:, :, None] * vectors[:, None, :]
    size = np.einsum("ni,ni->n", vectors, vectors)[:, None, None]
    return np.asarray(covariance + variance * (size * np.eye(3) - along))


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


_ANGLES = np.pi / 4 * np.arange(8)
_SHIFTS = np.array(
    [[0, 0], *np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)]) * np.where(np.arange(8) % 2, 2.5, 1.0)[:, None]]
)
"""What the regional field may be off by along its two least certain directions, from which fits begin, in units of its
standard errors there."""

_LEAST_FIELD, _SURE_FIELD = 5.0, 50.0
"""Field of a dipole over the largest standard error of the field beside it: below the least, that error is guessed, and
the dipole with it; above the sure one there is one solution."""

_ROUNDS = 3
"""Fits of each where the attitude is not exact, after the first with the turned field that the fit before leaves."""

_FARTHEST_M = 1e4
"""Beyond, what a fit has run away to is no place."""

_LARGEST_TURN = 0.5
"""Radians: no error of the attitude is as large, and what a wild fit leaves of the field was not made by one."""

_AS_GOOD = 9.0
"""χ² by which another dipole may be worse and still explain the sample: three standard deviations."""


def across_field(covariance: FloatArray, own: FloatArray, direction: FloatArray, attitude_noise: float) -> FloatArray:
    """Return covariances (N, 9, 9) of outputs less a regional field that is known but for a turn.

    Parameters
    ----------
    covariance : (9, 9) or (N, 9, 9) array
        Of the outputs, for all samples or each.
    own : (N, 3, 3) array
        Of the regional field in the array frame, T².
    direction : (N, 3) array
        Field that is turned, array frame, tesla: an error of the attitude goes across it.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """
    widened = np.broadcast_to(covariance, (len(direction), *covariance.shape[-2:])).copy()
    widened[:, :3, :3] += _beside(own, direction, attitude_noise)
    return widened


def less_turned(
    outputs: FloatArray, field_T: FloatArray, source_T: FloatArray, covariance: FloatArray, attitude_noise: float
) -> tuple[FloatArray, FloatArray]:
    """Return outputs (N, 8) less a regional field that is exact, or known but for a turn, and their covariances.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    field_T : (N, 3) array
        The regional field as the reported attitude has it in the array frame, tesla.
    source_T : (N, 3) array
        Nearly the source's field, array frame, tesla: the rest is the field that was turned.
    covariance : (9, 9) array
        Of the outputs.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.

    Returns
    -------
    seen : (N, 8) array
        Field and gradient of the source.
    covariance : (8, 8) or (N, 8, 8) array
        Theirs.
    """
    seen = outputs[:, :8].copy()
    seen[:, :3] -= field_T
    if not attitude_noise:
        return seen, covariance[:8, :8]
    left = outputs[:, :3] - source_T
    seen[:, :3] -= _longer(left, field_T)
    exact = np.zeros((len(outputs), 3, 3))
    return seen, across_field(covariance, exact, left, attitude_noise)[:, :8, :8]


def _beside(own: FloatArray, direction: FloatArray, attitude_noise: float) -> FloatArray:
    along = direction[:, :, None] * direction[:, None, :]
    size = np.einsum("ni,ni->n", direction, direction)[:, None, None]
    return np.asarray(own + attitude_noise**2 * (size * np.eye(3) - along))


def locate_turned(
    outputs: FloatArray,
    field_T: FloatArray,
    array: Array,
    covariance: FloatArray,
    own: FloatArray,
    attitude_noise: float,
    index: float = DIPOLE_INDEX,
) -> EulerSolutions:
    """Locate the source of each sample beside a field that is uncertain, or known but for a turn.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    field_T : (N, 3) array
        The regional field as the reported attitude has it in the array frame, tesla.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) or (N, 9, 9) array
        Of the outputs, for all samples or each.
    own : (N, 3, 3) array
        Of the regional field in the array frame, T².
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    index : float
        Structural index.

    Returns
    -------
    EulerSolutions
        With the reason of each sample that was not located.
    """
    source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
    euler = locate(source, across_field(covariance, own, field_T, attitude_noise), index=index)
    at, status = np.flatnonzero(euler.is_located), euler.status.copy()
    if not len(at):
        return euler
    noise = np.broadcast_to(covariance, (len(outputs), *covariance.shape[-2:]))[at]
    found, status[at] = _Samples(outputs[at], field_T[at], array, noise, own[at], attitude_noise, index).told()
    kept = status[at] == Status.LOCATED
    return EulerSolutions.of_fits(
        status, found.unknowns[kept], found.covariance[kept], found.chi_square[kept], index == DIPOLE_INDEX
    )


@dataclass(frozen=True, eq=False)
class _Found:
    """Sources (N, 6), their fields (N, 3) and covariances (N, 6, 6), which samples settled, which have other ones."""

    unknowns: FloatArray
    field_T: FloatArray
    covariance: FloatArray
    chi_square: FloatArray
    is_settled: np.ndarray
    is_ambiguous: np.ndarray

    def put(self, at: np.ndarray, other: "_Found") -> None:
        """Take those of some samples from another."""
        for name in ("unknowns", "field_T", "covariance", "chi_square", "is_settled", "is_ambiguous"):
            getattr(self, name)[at] = getattr(other, name)


@dataclass(frozen=True, eq=False)
class _Samples:
    """What ``locate_turned`` was given, of the samples that Euler's equation locates."""

    outputs: FloatArray
    field_T: FloatArray
    array: Array
    covariance: FloatArray
    own: FloatArray
    attitude_noise: float
    index: float

    def take(self, at: np.ndarray) -> "_Samples":
        """Return some of the samples."""
        names = ("outputs", "field_T", "covariance", "own")
        return replace(self, **{name: getattr(self, name)[at] for name in names})

    def told(self) -> tuple[_Found, np.ndarray]:
        """Return the sources that were found, and a ``Status`` for each."""
        found = self.best(_SHIFTS[:1])
        is_seen, is_alone = (self.is_above(times, found.field_T) for times in (_LEAST_FIELD, _SURE_FIELD))
        doubtful = np.flatnonzero(~found.is_settled | is_seen & ~is_alone)
        if len(doubtful):
            found.put(doubtful, self.take(doubtful).best(_SHIFTS))
        is_sure = is_certain(found.unknowns, found.covariance)
        status = np.where(found.is_ambiguous, Status.AMBIGUOUS, Status.LOCATED)
        status = np.where(found.is_settled & is_sure, status, Status.UNCERTAIN)
        is_hidden = (status == Status.LOCATED) & ~self.is_above(_LEAST_FIELD, found.field_T)
        return found, np.where(is_hidden, Status.NO_FIELD, status)

    def is_above(self, times: float, source_T: FloatArray) -> np.ndarray:
        """Return whether fields (N, 3) are more than so many of the largest standard errors of the field beside."""
        largest = np.linalg.eigvalsh(_beside(self.own, self.field_T, self.attitude_noise))[:, -1]
        return np.asarray(norm(source_T, axis=1) ** 2 > times**2 * largest)

    def best(self, shifts: FloatArray) -> _Found:
        """Return the best of the fits that begin with a field that is off by some shifts (S, 2)."""
        (solution, field_T), shape = self._fit(shifts), (len(shifts), len(self.outputs))
        is_settled = _is_near(solution)
        chi_square = np.where(is_settled, solution.chi_square, np.inf).reshape(shape)
        unknowns = np.where(is_settled[:, None], solution.unknowns, 1.0).reshape(*shape, 6)
        at = np.argmin(chi_square, axis=0), np.arange(shape[1])
        covariance = solution.covariance.reshape(*shape, 6, 6)[at]
        apart = np.sum((unknowns[..., :3] - unknowns[at][:, :3]) ** 2, axis=2)
        is_other = apart > _AS_GOOD * np.trace(covariance[:, :3, :3], axis1=1, axis2=2)
        is_as_good = chi_square < chi_square[at] + _AS_GOOD
        own = field_T.reshape(*shape, 3)[at]
        is_ambiguous = (is_other & is_as_good).any(axis=0)
        return _Found(unknowns[at], own, covariance, chi_square[at], np.isfinite(chi_square[at]), is_ambiguous)

    def _fit(self, shifts: FloatArray) -> tuple[Solution, FloatArray]:
        """Return the sources (S N), and their fields, that are found after each shift: all are fitted side by side."""
        values, vectors = np.linalg.eigh(_beside(self.own, self.field_T, self.attitude_noise))
        errors = np.sqrt(np.maximum(values[:, 1:], 0.0))
        shifted = np.einsum("ta,na,nia->tni", shifts, errors, vectors[:, :, 1:]).reshape(-1, 3)
        outputs, field_T, own, covariance = (
            np.tile(each, (len(shifts), *[1] * (each.ndim - 1)))
            for each in (self.outputs, self.field_T, self.own, self.covariance)
        )
        source = np.concatenate([outputs[:, :3] - field_T, outputs[:, 3:]], axis=1)
        seen = np.concatenate([source[:, :3] - shifted, source[:, 3:]], axis=1)
        start = np.nan_to_num(start_of(locate(seen, index=self.index), seen, self.index), nan=1.0)
        left, source_T = field_T, np.zeros_like(field_T)
        for _ in range(_ROUNDS if self.attitude_noise else 1):
            seen = source[:, :8].copy()
            seen[:, :3] -= _longer(left, field_T)
            noise = across_field(covariance, own, left, self.attitude_noise)[:, :8, :8]
            fit = fit_outputs(seen, self.array, noise, start, self.index)
            is_near = _is_near(fit.solution)[:, None]
            start = np.where(is_near, fit.solution.unknowns, start)
            source_T = np.where(is_near, fit.field_T, source_T)
            left = outputs[:, :3] - source_T
            is_turn = norm(left - field_T, axis=1) < _LARGEST_TURN * norm(field_T, axis=1)
            left = np.where(is_turn[:, None], left, field_T)
        return fit.solution, source_T


def _is_near(solution: Solution) -> np.ndarray:
    """Return which fits settled somewhere."""
    return np.asarray(solution.is_found & (np.abs(solution.unknowns[:, :3]).max(axis=1) < _FARTHEST_M))


def _longer(turned: FloatArray, field_T: FloatArray) -> FloatArray:
    """Return by how much fields (N, 3) are longer along what they are turned to than their part along it."""
    unit = turned / norm(turned, axis=1, keepdims=True)
    return np.asarray(unit * (norm(field_T, axis=1) - np.einsum("ni,ni->n", unit, field_T))[:, None])
