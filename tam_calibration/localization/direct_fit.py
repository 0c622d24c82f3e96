"""A dipole or a loop fitted to the K readings themselves, of one pose of the array or of many together."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.euler import locate
from tam_calibration.localization.source_problem import Kernel, Problem, solve
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import Dipole, dipole_field
from tam_calibration.sources.loop import Loop, area_of, loop_field
from tam_calibration.sources.poses import ONE_POSE, Poses


@dataclass(frozen=True, eq=False)
class Readings:
    """Fields at the sensors of an array in N poses, and the kind of source that makes them.

    Parameters
    ----------
    kernel : Kernel
        The source's field.
    array : Array
        Positions and noise of the sensors; a noise that is not stated is taken as one tesla.
    poses : Poses
        Of the array.
    world_T : (N, K, 3) array
        Fields at the sensors, turned into the world, tesla.
    uniform_field_T : (3,) array
        What is known of the field beside the source's, in the world, tesla.
    fit_uniform_field : bool
        Whether a uniform field is unknown.
    """

    kernel: Kernel
    array: Array
    poses: Poses
    world_T: FloatArray
    uniform_field_T: FloatArray
    fit_uniform_field: bool

    @property
    def points_m(self) -> FloatArray:
        """(N, K, 3) places of the sensors in the world, metres."""
        points: FloatArray = self.poses.position_m[:, None] + np.einsum(
            "nij,kj->nki", self.poses.matrix, self.array.positions_m
        )
        return points

    def whitened(self, solution: Solution | None = None) -> tuple[Problem, FloatArray]:
        """Return the problem, and its data (1, 3 K N).

        The noise of the attitude has the direction of the field across itself. Without a solution this is the field
        as measured; with one it is half way from there to the field that is expected, as an error that turns the field
        from the one to the other is then at right angles to it, to the second order too.
        """
        measured = self.world_T.mean(axis=1)
        field = measured if solution is None else (measured + self._expected(solution)) / 2
        whitening = self._whitening(field)
        count = 3 * self.array.sensor_count
        everywhere = (
            np.tile(np.eye(3), (self.array.sensor_count, 1)) if self.fit_uniform_field else np.zeros((count, 0))
        )
        problem = Problem(self.kernel, self.points_m, whitening, whitening @ everywhere)
        return problem, (whitening @ self.of_source_T.reshape(len(measured), count, 1)).reshape(1, -1)

    @property
    def of_source_T(self) -> FloatArray:
        """(N, K, 3) fields in the world less what is known beside the source's."""
        return self.world_T - self.uniform_field_T

    def _expected(self, solution: Solution) -> FloatArray:
        """Return the (N, 3) field at the array's centre, attitude apart."""
        position, moment, uniform = np.split(solution.unknowns[0], (3, 6))
        field = self.kernel(self.poses.position_m - position, moment)[0] + self.uniform_field_T
        return field + uniform if len(uniform) else field

    def _whitening(self, field_T: FloatArray) -> FloatArray:
        """Return the (N, 3 K, 3 K) square roots of the inverse noise.

        An error ω of the attitude turns the whole field, ω × B in every sensor; the sensors' own has no direction.
        """
        sensors = self.array.sensor_count
        noise = np.ones(sensors) if self.array.vector_noise_T is None else self.array.vector_noise_T
        own = np.diag(1 / np.repeat(noise, 3))
        if self.poses.attitude_noise == 0:
            return np.broadcast_to(own, (len(field_T), *own.shape))
        turn = self.poses.attitude_noise * np.swapaxes(np.cross(field_T[:, None], np.eye(3)), 1, 2)
        common = own @ np.tile(turn, (1, sensors, 1))
        values, vectors = np.linalg.eigh(np.eye(3 * sensors) + common @ np.swapaxes(common, 1, 2))
        whitening: FloatArray = np.swapaxes(vectors, 1, 2) / np.sqrt(values)[..., None] @ own
        return whitening


_STARTS, _REWEIGHTINGS = 24, 2


@dataclass(frozen=True, eq=False)
class SourceFit:
    """A source that was fitted.

    Parameters
    ----------
    source : Dipole or Loop
        In the world, or in the array frame where no attitude was given.
    covariance : (6, 6) or (9, 9) array
        Of position [m], moment [A m²] and, where it was fitted, the uniform field [T].
    uniform_field_T : (3,) array, optional
        The field that is uniform in the world, where it was fitted, tesla.
    chi_square : float
        Sum of the squared residuals over the noise.
    degrees_of_freedom : int
        Number of values less the unknowns: what ``chi_square`` is expected to be.
    """

    source: Dipole | Loop
    covariance: FloatArray
    uniform_field_T: FloatArray | None
    chi_square: float
    degrees_of_freedom: int

    @property
    def position_standard_errors_m(self) -> FloatArray:
        """(3,) standard errors of the position, metres."""
        errors: FloatArray = np.sqrt(np.diag(self.covariance)[:3])
        return errors

    @property
    def moment_standard_error_Am2(self) -> float:
        """Standard error of the moment's size, A m²."""
        unit = self.source.moment_Am2 / norm(self.source.moment_Am2)
        return float(np.sqrt(unit @ self.covariance[3:6, 3:6] @ unit))

    @property
    def current_standard_error_A(self) -> float:
        """Standard error of a loop's current times turns, ampere; NaN for a dipole."""
        if isinstance(self.source, Dipole):
            return float("nan")
        return self.moment_standard_error_Am2 / area_of(self.source.radius_m)


def fit_dipole(
    fields_T: FloatArray,
    array: Array,
    poses: Poses = ONE_POSE,
    *,
    uniform_field_T: FloatArray | None = None,
    fit_uniform_field: bool = False,
) -> SourceFit:
    """Fit a dipole to the fields at the sensors.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings of each pose, array frame, tesla: of the source alone, or with a field beside it that is
        uniform in the world.
    array : Array
        Positions and noise of the sensors; without a stated noise it is taken from the residuals.
    poses : Poses
        Of the array; by default one, in which the array frame is the world.
    uniform_field_T : (3,) array, optional
        Of the field beside the source's in the world, where it is known, tesla.
    fit_uniform_field : bool
        Whether there is an unknown field beside the source's.

    Returns
    -------
    SourceFit
        In the world.

    Raises
    ------
    InputError
        When a shape is wrong, values are not finite, or the axes of the array are known to sit in different places.
    Refused
        When the readings do not determine the source.
    """
    return _fit(dipole_field, None, fields_T, array, poses, uniform_field_T, fit_uniform_field)


def fit_loop(
    fields_T: FloatArray,
    array: Array,
    radius_m: float,
    poses: Poses = ONE_POSE,
    *,
    uniform_field_T: FloatArray | None = None,
    fit_uniform_field: bool = False,
) -> SourceFit:
    """Fit a circular loop of known radius to the fields at the sensors.

    Parameters
    ----------
    fields_T : (N, K, 3) array
        Calibrated readings of each pose, array frame, tesla: of the source alone, or with a field beside it that is
        uniform in the world.
    array : Array
        Positions and noise of the sensors; without a stated noise it is taken from the residuals.
    radius_m : float
        Of the loop, metres.
    poses : Poses
        Of the array; by default one, in which the array frame is the world.
    uniform_field_T : (3,) array, optional
        Of the field beside the source's in the world, where it is known, tesla.
    fit_uniform_field : bool
        Whether there is an unknown field beside the source's.

    Returns
    -------
    SourceFit
        In the world.

    Raises
    ------
    InputError
        When a shape or the radius is wrong or values are not finite.
    Refused
        When the readings do not determine the source.
    """
    if not (np.isfinite(radius_m) and radius_m > 0):
        raise InputError(f"the radius of the loop must be a positive number of metres, not {radius_m}")
    kernel = partial(loop_field, radius_m=radius_m)
    return _fit(kernel, radius_m, fields_T, array, poses, uniform_field_T, fit_uniform_field)


def _fit(
    kernel: Kernel,
    radius_m: float | None,
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    uniform_field_T: FloatArray | None,
    fit_uniform_field: bool,
) -> SourceFit:
    world = poses.into_world(_check(fields_T, array, poses))
    known = np.zeros(3) if uniform_field_T is None else _check_uniform(uniform_field_T, fit_uniform_field)
    readings = Readings(kernel, array, poses, world, known, fit_uniform_field)
    problem, data = readings.whitened()
    freedom = data.size - 6 - problem.linear.shape[2]
    if freedom < 0:
        raise Refused(f"{data.size} values do not determine {data.size - freedom} unknowns: use more sensors or poses")
    solution = solve(problem, data, _start(readings))
    for _ in range(_REWEIGHTINGS if poses.attitude_noise else 0):
        problem, data = readings.whitened(solution)
        solution = solve(problem, data, solution.unknowns)
    if not solution.is_found[0]:
        raise Refused(
            "the readings do not determine the source: it is too far, too weak, or always seen from the same side"
        )
    return _result(solution, radius_m, array, freedom, fit_uniform_field)


def _check(fields_T: FloatArray, array: Array, poses: Poses) -> FloatArray:
    if array.axis_offsets_m is not None:
        raise InputError("the direct fit takes the axes of a sensor to be in one place: locate from field and gradient")
    fields = np.asarray(fields_T, dtype=float)
    shape = (len(poses.attitude), array.sensor_count, 3)
    if fields.shape != shape:
        raise InputError(f"the fields must have the shape {shape} of poses and sensors, not {fields.shape}")
    if not np.isfinite(fields).all():
        raise InputError("a field is not finite: leave out that sample")
    return fields


def _check_uniform(uniform_field_T: FloatArray, is_fitted: bool) -> FloatArray:
    uniform = np.asarray(uniform_field_T, dtype=float)
    if uniform.shape != (3,) or not np.isfinite(uniform).all():
        raise InputError("the uniform field must be three finite numbers in the frame of the world, tesla")
    if is_fitted:
        raise InputError("the uniform field is either known or fitted, not both")
    return uniform


def _start(readings: Readings) -> FloatArray:
    """Return the best of the Euler solutions of the poses with the strongest gradients."""
    array, poses, world = readings.array, readings.poses, readings.of_source_T
    if not array.has_gradient:
        raise Refused("the array's geometry determines no gradient, so that the fit has nowhere to start")
    if readings.fit_uniform_field:
        world = world - np.median(world.mean(axis=1), axis=0)
    outputs = np.einsum("nji,nkj->nki", poses.matrix, world).reshape(len(world), -1) @ array.operator.T
    solutions = locate(outputs)
    strongest = np.argsort(-norm(outputs[:, 3:], axis=1), kind="stable")
    chosen = strongest[solutions.is_located[strongest]][:_STARTS]
    if not len(chosen):
        raise Refused("the field or its gradient is zero in every pose: there is no source to be seen")
    places = poses.place_in_world(solutions.position_m)[chosen]
    problem, data = readings.whitened()
    shared = np.broadcast_to(data, (len(places), data.shape[1]))
    starts = problem.start(shared, places)
    residuals = [np.sum((data - problem.predict(start[None])[0]) ** 2) for start in starts]
    return starts[[int(np.argmin(residuals))]]


def _result(
    solution: Solution, radius_m: float | None, array: Array, freedom: int, has_uniform_field: bool
) -> SourceFit:
    position, moment, rest = np.split(solution.unknowns[0], (3, 6))
    chi_square, covariance = float(solution.chi_square[0]), solution.covariance[0]
    if array.vector_noise_T is None:
        variance = chi_square / freedom if freedom else np.nan
        chi_square, covariance = float(freedom), covariance * variance
    source = Dipole(position, moment) if radius_m is None else Loop(position, moment, radius_m)
    return SourceFit(source, covariance, rest if has_uniform_field else None, chi_square, freedom)
