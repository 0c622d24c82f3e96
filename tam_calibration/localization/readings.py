"""The readings of an array in many poses as a least-squares problem of unit noise."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.array import Array
from tam_calibration.localization.least_squares import Kernel, Problem, Solution
from tam_calibration.localization.poses import Poses
from tam_calibration.units import FloatArray


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
