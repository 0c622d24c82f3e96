"""The gradient of the ambient field at a site that is not perfect: uniform in the world, turning in the array frame.

At attitude R (array to world) a sensor at r reads b + Rᵀ G R r, with G symmetric and trace-free in the world.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.harmonics import derivatives, fields
from tam_calibration.effects.covariates import LEAST_TURN, to_world
from tam_calibration.effects.effect import ALL, Coefficient, Covariates, LinearEffect, Shape, Term
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


def turned(tensors: FloatArray, attitude: FloatArray) -> FloatArray:
    """Return tensors (P, 3, 3) of the world as (N, P, 3, 3) in the array frame at attitudes (N, 4).

    Parameters
    ----------
    tensors : (P, 3, 3) array
        P gradients in the world, T/m.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array to the world.
    """
    from scipy.spatial.transform import Rotation

    matrix = Rotation.from_quat(attitude).as_matrix()[:, None]
    return np.asarray(np.swapaxes(matrix, 2, 3) @ tensors @ matrix)


def gradient_field(gradient_T_per_m: FloatArray, attitude: FloatArray, positions_m: FloatArray) -> FloatArray:
    """Return what a gradient (3, 3) of the world adds to the field at positions (P, 3) of the array: (N, P, 3), T.

    Parameters
    ----------
    gradient_T_per_m : (3, 3) array
        Gradient of the ambient field in the world, T/m.
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array to the world.
    positions_m : (P, 3) array
        Positions in the array frame, metres.
    """
    tensors = turned(gradient_T_per_m[None], attitude)[:, 0]
    return np.asarray(np.einsum("nij,pj->npi", tensors, positions_m))


def require_attitude(recording: Recording) -> Recording:
    """Return the samples of a recording whose attitude is known.

    Raises
    ------
    InputError
        When there are none.
    """
    if recording.attitude is None:
        raise InputError(
            "an ambient gradient turns in the array frame as the array is turned, and the recording has no attitude: "
            "record it, or calibrate where the field is uniform"
        )
    known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
    return recording if len(known) == recording.sample_count else recording.take(known)


def without_gradient(
    recording: Recording, errors: SensorErrors, array: Array, gradient_T_per_m: FloatArray
) -> Recording:
    """Return what the sensors and the scalar magnetometer would have read in the field of the array's centre.

    Parameters
    ----------
    recording : Recording
        With attitude; samples without are left out.
    errors : SensorErrors
        Of the sensors.
    array : Array
        Positions of the sensors and of the scalar magnetometer.
    gradient_T_per_m : (3, 3) array
        Gradient of the ambient field in the world, T/m.

    Raises
    ------
    InputError
        When the recording has no attitude.
    """
    recording = require_attitude(recording)
    assert recording.attitude is not None
    at_sensors = gradient_field(gradient_T_per_m, recording.attitude, array.positions_m)
    readings = recording.readings_T - np.einsum("kij,nkj->nki", errors.matrix, at_sensors)
    scalar = recording.scalar_T
    if scalar is not None and array.scalar_position_m is not None:
        center = errors.restore(readings).mean(axis=1)
        at_scalar = gradient_field(gradient_T_per_m, recording.attitude, array.scalar_position_m[None])[:, 0]
        scalar = scalar - norm(center + at_scalar, axis=1) + norm(center, axis=1)
    return replace(recording, readings_T=readings, scalar_T=scalar)


_DEGREES = {2: "T/m", 3: "T/m²", 4: "T/m³"}
"""Units of the derivatives of a potential, by its degree."""


class AmbientGradient(LinearEffect):
    """The field of the site is not uniform; the array turns about its centre, which stays where it is."""

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that all sensors are at the centre or that the array was not turned, where it is so."""
        from scipy.spatial.transform import Rotation

        if not covariates.array.positions_m.any() and not _has_distant_scalar(covariates.array):
            return "all sensors are at the centre of rotation"
        rotation = Rotation.from_quat(covariates.channel("attitude"))
        half = (rotation.mean().inv() * rotation).magnitude() / 2
        turn = 2 * float(np.arcsin(np.sqrt(np.mean(np.sin(half) ** 2))))  # a few attitudes that are wrong count little
        return f"the attitude changes by {turn:.2f} rad only" if turn < LEAST_TURN else None

    def terms(self, covariates: Covariates, shape: Shape) -> Iterator[Term]:
        """Yield the harmonic potentials of degree 2, 3 and 4, by their derivatives in the world at the centre."""
        array = covariates.array
        rotation = np.ascontiguousarray(to_world(covariates).transpose(1, 2, 0))
        places = list(zip(array.positions_m, covariates.errors.matrix[..., None], strict=True))
        if array.scalar_position_m is not None and _has_distant_scalar(array):
            places.append((array.scalar_position_m, covariates.direction.T[None]))
        for degree, unit in _DEGREES.items():
            names = ["".join(np.repeat(list("xyz"), orders)) for orders in derivatives(degree)]
            row_count = sum(len(matrix) for _, matrix in places)
            rows, columns = np.divmod(np.arange(row_count * len(names)), len(names))
            features = np.empty((len(rows), covariates.sample_count))
            stop = 0
            for position, matrix in places:
                start, stop = stop, stop + len(matrix) * len(names)
                features[start:stop] = _signal_at(degree, position, matrix, rotation)
            parts = tuple(Coefficient(f"gradient {name}", unit) for name in names)
            yield Term(ALL, None, f"degree {degree}", parts, features.T, rows, columns)
            del features


def _signal_at(degree: int, position_m: FloatArray, matrix: FloatArray, rotation: FloatArray) -> FloatArray:
    """Return the signal of P harmonic potentials of the world in R rows at a position, (R P, N).

    The rows read by a matrix (R, 3, N or 1) in the array frame, which rotations (3, 3, N) turn to the world.
    """
    in_world = fields(degree, np.tensordot(position_m, rotation, axes=(0, 1)))
    reading = np.einsum("rjn,ijn->rin", np.broadcast_to(matrix, (*matrix.shape[:2], rotation.shape[2])), rotation)
    return np.asarray(np.einsum("rin,pin->rpn", reading, in_world).reshape(-1, rotation.shape[2]))


def _has_distant_scalar(array: Array) -> bool:
    return array.scalar_position_m is not None and bool(array.scalar_position_m.any())
