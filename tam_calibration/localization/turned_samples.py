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

from dataclasses import dataclass, field, replace
from functools import cached_property, partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import noise_deviation
from tam_calibration.fit.contradiction import PLAUSIBLE
from tam_calibration.localization.euler import DIPOLE_INDEX, locate
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.localization.source_fit import (
    PLACE_ERROR_M,
    Fit,
    elements_of,
    fit_fields,
    is_certain,
    places_of,
    require_index,
    start_of,
    unknowns_of,
)
from tam_calibration.model.array import Array, tensors_of
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import BLOCK
from tam_calibration.model.units import FloatArray

_TENTHS = 10
"""Parts of a run whose medians tell how certain the regional field is."""


@dataclass(frozen=True, eq=False)
class Samples:
    """What is known of N samples, the source of each of which is sought.

    Parameters
    ----------
    outputs : (N, 9) array
        Field and gradient, array frame, tesla and T/m.
    array : Array
        Whose outputs they are.
    covariance : (9, 9) or (N, 9, 9) array
        Of the outputs, for all samples or each.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world, needed where there is a regional field; NaN where
        unknown, which refuses the sample.
    index : float
        Structural index: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current; of a line its nearest point is
        located.

    Raises
    ------
    InputError
        When the structural index is none of these.
    """

    outputs: FloatArray
    array: Array
    covariance: FloatArray
    attitude: FloatArray | None = None
    index: float = DIPOLE_INDEX

    def __post_init__(self) -> None:
        """Check the structural index."""
        require_index(self.index)

    @property
    def freedom(self) -> int:
        """Outputs of a sample beyond the unknowns of its source."""
        return 8 - unknowns_of(self.index)

    @cached_property
    def rotation(self) -> FloatArray:
        """(N, 3, 3) rotations from the array frame to the world, NaN where they are unknown."""
        if self.attitude is None:
            raise InputError("without an attitude the regional field cannot be taken off")
        return matrices_of(self.attitude)

    def take(self, at: np.ndarray | slice) -> "Samples":
        """Return some of the samples."""
        covariance = self.covariance if self.covariance.ndim == 2 else self.covariance[at]
        attitude = None if self.attitude is None else self.attitude[at]
        return replace(self, outputs=self.outputs[at], covariance=covariance, attitude=attitude)


@dataclass(frozen=True, eq=False)
class Regional:
    """The field beside that of the source, uniform in the world of the attitude.

    Parameters
    ----------
    field_T : (3,) array
        In the world, tesla.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    covariance_T2 : (3, 3) array
        Of the field, T²; zero of an exact one.
    """

    field_T: FloatArray
    attitude_noise: float = 0.0
    covariance_T2: FloatArray = field(default_factory=partial(np.zeros, (3, 3)))


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
    field_T = np.median(world, axis=0) / (1 - attitude_noise**2 / 2)
    tenths = np.array([np.median(part, axis=0) for part in np.array_split(world, _TENTHS) if len(part)])
    spread = noise_deviation(tenths - np.median(tenths, axis=0), axis=0)
    return Regional(field_T, attitude_noise, np.diag(spread**2))


def locate_samples(samples: Samples, regional: Regional | None = None) -> EulerSolutions:
    """Locate the source of each sample; a sample's result does not depend on its neighbours.

    It is located with the array's true baselines. Where the source leaves too much of the outputs, the places of the
    sensors are taken for uncertain; where it still does, the sample is refused.

    Parameters
    ----------
    samples : Samples
        Their outputs.
    regional : Regional, optional
        What is taken off the field; without it the outputs are those of the source alone.

    Returns
    -------
    EulerSolutions
        In the array frame.

    Raises
    ------
    InputError
        When a shape or the structural index is wrong, the covariance is none, or there is no attitude.
    """
    found = locate_each(samples, regional)
    at = found.misfits(samples.freedom)
    if not len(at):
        return found
    some = samples.take(at)
    by_places = PLACE_ERROR_M * some.array.operator @ places_of(tensors_of(some.outputs), some.array.sensor_count)
    widened = replace(some, covariance=some.covariance + by_places @ np.swapaxes(by_places, 1, 2))
    return found.put(at, locate_each(widened, regional).tested(samples.freedom))


def locate_each(samples: Samples, regional: Regional | None = None) -> EulerSolutions:
    """Do the same, whatever the source leaves: see ``EulerSolutions.chi_square``."""
    count = len(samples.outputs)
    if not samples.array.has_gradient:
        return EulerSolutions.refused(count, Status.NOT_FINITE)
    # In pieces of bounded size, so that what is worked out on the way stays small.
    pieces = [samples.take(slice(start, start + BLOCK)) for start in range(0, max(count, 1), BLOCK)]
    solutions = EulerSolutions.joined([Beside.of(piece, regional).located() for piece in pieces])
    return solutions if regional is None else _unless_unknown(solutions, samples.rotation)


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
    position, moment, along = (
        (matrix @ vectors[..., None])[..., 0]
        for vectors in (solutions.position_m, solutions.moment_Am2, solutions.along)
    )
    of_position = matrix @ _turning(solutions.position_covariance_m2, solutions.position_m, variance) @ back
    of_moment = matrix @ _turning(solutions.moment_covariance_A2m4, solutions.moment_Am2, variance) @ back
    world = EulerSolutions(position, of_position, moment, of_moment, solutions.status, solutions.chi_square, along)
    return _unless_unknown(world, matrix)


def _turning(covariance: FloatArray, vectors: FloatArray, variance: float) -> FloatArray:
    """Add to the covariances (N, 3, 3) of vectors (N, 3) what turns of a variance about each axis make of them."""
    along = vectors[:, :, None] * vectors[:, None, :]
    size = np.einsum("ni,ni->n", vectors, vectors)[:, None, None]
    return np.asarray(covariance + variance * (size * np.eye(3) - along))


def _unless_unknown(solutions: EulerSolutions, rotation: FloatArray) -> EulerSolutions:
    """Name the attitude as the reason where it is unknown."""
    status = np.where(np.isfinite(rotation).all(axis=(1, 2)), solutions.status, Status.NO_ATTITUDE)
    return replace(solutions, status=status)


_SHIFTS = np.array([0, *np.exp(1j * np.pi / 4 * np.arange(8)) * np.tile([1.0, 2.5], 4)]).view(float).reshape(-1, 2)
"""What the regional field may be off by along its two least certain directions, from which fits begin, in units of its
standard errors there."""

_LEAST_FIELD, _SURE_FIELD = 5.0, 50.0
"""Field of a dipole over the largest standard error of the field beside it: below the least, that error is guessed, and
the dipole with it; above the sure one there is one solution."""

_ROUNDS = 3
"""Fits of each where the attitude is not exact, after the first with the turned field that the fit before leaves."""


@dataclass(frozen=True, eq=False)
class _Found(Fit):
    """The best of several fits, and which samples (N,) have other ones."""

    is_ambiguous: np.ndarray

    def put(self, at: np.ndarray, other: "_Found") -> None:
        """Take those of some samples from another."""
        for name, value in vars(self).items():
            value[at] = getattr(other, name)


@dataclass(frozen=True, eq=False)
class Beside:
    """N samples beside a regional field that is uncertain, and known but for a turn.

    Parameters
    ----------
    samples : Samples
        The samples.
    field_T : (N, 3) array
        The regional field as the reported attitude has it in the array frame, tesla.
    own : (N, 3, 3) array
        Covariance of the regional field in the array frame, T².
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """

    samples: Samples
    field_T: FloatArray
    own: FloatArray
    attitude_noise: float

    @classmethod
    def of(cls, samples: Samples, regional: Regional | None) -> "Beside":
        """Return samples beside a field that is uniform in the world of their attitude, or beside none."""
        if regional is None:
            count = len(samples.outputs)
            return cls(samples, np.zeros((count, 3)), np.zeros((count, 3, 3)), 0.0)
        back = np.swapaxes(samples.rotation, 1, 2)
        own = back @ regional.covariance_T2 @ samples.rotation
        return cls(samples, back @ regional.field_T, own, regional.attitude_noise)

    def take(self, at: np.ndarray) -> "Beside":
        """Return some of the samples."""
        return replace(self, samples=self.samples.take(at), field_T=self.field_T[at], own=self.own[at])

    def less(self, turned_T: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the outputs (N, 8) less the field, and their covariances (N, 8, 8).

        Parameters
        ----------
        turned_T : (N, 3) array
            Nearly what the field was turned to, array frame, tesla; the field itself where the attitude is exact. An
            error of the attitude goes across it.
        """
        size = norm(turned_T, axis=1, keepdims=True)
        unit = np.divide(turned_T, size, out=np.zeros_like(turned_T), where=size > 0)
        longer = norm(self.field_T, axis=1) - np.einsum("ni,ni->n", unit, self.field_T)
        seen = self.samples.outputs[:, :8].copy()
        widened = np.array(np.broadcast_to(self.samples.covariance[..., :8, :8], (len(seen), 8, 8)))
        seen[:, :3] -= self.field_T + unit * longer[:, None]
        widened[:, :3, :3] += _turning(self.own, turned_T, self.attitude_noise**2)
        return seen, widened

    @property
    def spread(self) -> FloatArray:
        """(N, 3, 3) covariance of the field, T²."""
        return _turning(self.own, self.field_T, self.attitude_noise**2)

    def located(self) -> EulerSolutions:
        """Return the sources of those samples that Euler's equation locates, and the reason of each that was not."""
        index = self.samples.index
        euler = locate(*self.less(self.field_T), index=index)
        at = np.flatnonzero(euler.is_located)
        if not len(at):
            return euler
        seen = self.take(at)
        error_T = np.sqrt(np.maximum(np.linalg.eigvalsh(seen.spread)[:, -1], 0.0))
        # Of one sample, as live ones are, all fits take hardly longer than the first.
        every = seen.fits(seen.starts()) if len(at) == 1 and error_T[0] > 0 else None
        first = seen.fits(start_of(euler.take(at), index)[None]) if every is None else every.take(np.arange(1))
        found = _best(first, len(at))

        def is_above(times: float) -> np.ndarray:
            return np.asarray(norm(found.field_T, axis=1) > times * error_T)

        is_doubtful = ~found.is_found | is_above(_LEAST_FIELD) & ~is_above(_SURE_FIELD)
        doubtful = np.flatnonzero(is_doubtful & (error_T > 0))
        if len(doubtful):
            some = seen.take(doubtful)
            found.put(doubtful, _best(some.fits(some.starts()) if every is None else every, len(doubtful)))
        is_sure = found.is_found & is_certain(found.unknowns, found.covariance)
        status, reasons = euler.status.copy(), (Status.UNCERTAIN, Status.AMBIGUOUS, Status.NO_FIELD)
        status[at] = np.select([~is_sure, found.is_ambiguous, ~is_above(_LEAST_FIELD)], reasons, Status.LOCATED)
        return EulerSolutions.of_fits(status, found.take(status[at] == Status.LOCATED), index == DIPOLE_INDEX)

    def starts(self) -> FloatArray:
        """Return Euler's solutions (S, N, 6) for a field that is off by each of ``_SHIFTS``."""
        index, values, vectors = self.samples.index, *np.linalg.eigh(self.spread)
        errors = np.sqrt(np.maximum(values[:, 1:], 0.0))
        seen = np.tile(self.less(self.field_T)[0], (len(_SHIFTS), 1, 1))
        seen[..., :3] -= np.einsum("ta,na,nia->tni", _SHIFTS, errors, vectors[:, :, 1:])
        euler = locate(seen.reshape(-1, 8), index=index)
        return np.nan_to_num(start_of(euler, index), nan=1.0).reshape(*seen.shape[:2], 6)

    def fits(self, starts: FloatArray) -> Fit:
        """Return the S N fits that begin with several sources (S, N, 6) of each sample: all side by side."""
        return self.take(np.tile(np.arange(starts.shape[1]), len(starts))).fitted(starts.reshape(-1, 6))

    def fitted(self, start: FloatArray) -> Fit:
        """Return the sources that are found from places and moments, or vectors along lines (N, 6)."""
        outputs, array, index = self.samples.outputs, self.samples.array, self.samples.index
        points, by_points = elements_of(array, array.operator[:8])
        turned_T, source_T = self.field_T, np.zeros_like(self.field_T)
        for _ in range(_ROUNDS if self.attitude_noise else 1):
            seen, noise = self.less(turned_T)
            fit = fit_fields(seen, points, by_points, noise, start, index)
            is_found = fit.is_found[:, None]
            start = np.where(is_found, fit.unknowns, start)
            source_T = np.where(is_found, fit.field_T, source_T)
            left = outputs[:, :3] - source_T
            # What a wild fit leaves of the field was not made by an error of the attitude.
            is_turn = norm(left - self.field_T, axis=1) < ATTITUDE_NOISE.most * norm(self.field_T, axis=1)
            turned_T = np.where(is_turn[:, None], left, self.field_T)
        return replace(fit, field_T=source_T)


def _best(fits: Fit, count: int) -> _Found:
    """Return the best of the S N fits of N samples."""
    numbers = np.arange(len(fits.unknowns)).reshape(-1, count)
    chi_square = np.where(fits.is_found, fits.chi_square, np.inf)[numbers]
    found = fits.take(numbers[chi_square.argmin(axis=0), np.arange(count)])
    with np.errstate(over="ignore", invalid="ignore"):  # a fit that was not found may be anywhere
        apart = np.sum((fits.unknowns[numbers, :3] - found.unknowns[:, :3]) ** 2, axis=2)
    is_other = apart > np.trace(found.covariance[:, :3, :3], axis1=1, axis2=2)
    # Another dipole explains the sample as long as its likelihood is not much less.
    is_ambiguous = (is_other & (chi_square < found.chi_square - 2 * np.log(PLAUSIBLE))).any(axis=0)
    return _Found(**vars(found), is_ambiguous=is_ambiguous)
