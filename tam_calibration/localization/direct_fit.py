"""A dipole or a loop fitted to the K readings themselves, of one pose of the array or of many together."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.passage import OF_SOURCE, UNIFORM, Known, Passage
from tam_calibration.localization.source_problem import Kernel
from tam_calibration.localization.track_fit import fit_sources
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import Dipole, dipole_field
from tam_calibration.sources.loop import Loop, area_of, loop_field
from tam_calibration.sources.poses import ONE_POSE, Poses


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
    expected, standard_error = np.zeros((2, 11))
    if uniform_field_T is not None:
        expected[UNIFORM] = _check_uniform(uniform_field_T, fit_uniform_field)
    standard_error[UNIFORM] = np.inf if fit_uniform_field else 0.0
    passage = passage_of(kernel, fields_T, array, poses, Known(expected, standard_error))
    freedom = passage.degrees_of_freedom - OF_SOURCE
    return _result(fit_sources(passage, 1), radius_m, array, freedom, fit_uniform_field)


def passage_of(
    kernel: Kernel,
    fields_T: FloatArray,
    array: Array,
    poses: Poses,
    known: Known,
    time_s: FloatArray | None = None,
) -> Passage:
    """Return what readings are as a problem of least squares.

    Parameters
    ----------
    kernel : Kernel
        The field of a source.
    fields_T : (N, K, 3) array
        Calibrated readings of each pose, array frame, tesla.
    array : Array
        Positions and noise of the sensors; a noise that is not stated is taken as one tesla.
    poses : Poses
        Of the array.
    known : Known
        What is known of the field beside the sources', and of the velocity.
    time_s : (N,) array, optional
        Since the poses were reckoned by a velocity, seconds.

    Raises
    ------
    InputError
        When a shape is wrong, values are not finite, or the axes of the array are known to sit in different places.
    Refused
        When there are fewer values than unknowns of one source, or the array has no gradient to start from.
    """
    readings, stated = _check(fields_T, array, poses), array.vector_noise_T
    noise = np.ones(array.sensor_count) if stated is None else stated
    times = np.zeros(len(readings)) if time_s is None else time_s
    passage = Passage(
        kernel, readings, array, noise, poses.matrix, poses.position_m, times, poses.attitude_noise, known
    )
    lacking = OF_SOURCE - passage.degrees_of_freedom
    if lacking > 0:
        values = readings.size
        raise Refused(f"{values} values do not determine {values + lacking} unknowns: use more sensors or poses")
    if not array.has_gradient:
        raise Refused("the array's geometry determines no gradient, so that the fit has nowhere to start")
    return passage


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
