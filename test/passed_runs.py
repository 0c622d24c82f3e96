"""Runs of a cross that passes a source, as ``one_source`` and ``shared_source`` see them."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.sources.dipole import Dipole

TRUE_T = np.array([1e-6, 20e-6, -45e-6])
NOISE_T = 1e-10
ARRAY = Array.cross(0.5, vector_noise_T=NOISE_T)
NOISE = ARRAY.operator @ ARRAY.operator.T * NOISE_T**2
COUNT = 60


def course(count, reach_m=8.0):
    """Return a straight path (N, 3) and the attitudes of a platform that sways."""
    path = np.outer(np.linspace(-reach_m, reach_m, count), [1.0, 0.2, 0.0])
    return path, Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(np.linspace(0, 60, count), [0.2, 0.33, 0.5])))


PATH_M, SWAY = course(COUNT)


def dipole(strength=1.0, place_m=(0.5, 1.0, -3.0)):
    """Return a dipole of 200 A m² times a strength."""
    return Dipole(np.array(place_m), strength * np.array([120.0, -80.0, 140.0]))


@dataclass(frozen=True)
class Line:
    """A line along y: of a current of 10 A, index 1, or of dipoles, index 2."""

    position_m: np.ndarray
    index: int

    def field_T(self, points_m):
        """Return the field (..., 3) at points (..., 3), tesla."""
        across = (points_m - self.position_m) * [1.0, 0.0, 1.0]
        square = np.sum(across**2, axis=-1, keepdims=True)
        if self.index == 1:
            return 2e-6 * np.cross([0.0, 1.0, 0.0], across) / square
        moment = np.array([60.0, 0.0, 90.0])
        return 2e-7 * (2 * across * (across @ moment)[..., None] / square - moment) / square


def line(index, place_m=(0.0, 0.0, -3.0)):
    """Return a line below the path."""
    return Line(np.array(place_m), index)


def passed(seed, sources, attitude_noise=0.0, gradient_T_per_m=0.0, path_and_sway=(PATH_M, SWAY)):
    """Return outputs (N, 9) and reported attitudes (N, 4) of a run."""
    generator, (path, sway) = np.random.default_rng(seed), path_and_sway
    points = path[:, None] + np.einsum("nij,kj->nki", sway.as_matrix(), ARRAY.positions_m)
    world = TRUE_T + gradient_T_per_m * points * [1.0, 0.0, -1.0]
    for source in sources:
        world = world + source.field_T(points)
    fields = np.einsum("nji,nkj->nki", sway.as_matrix(), world) + NOISE_T * generator.normal(size=world.shape)
    reported = sway * Rotation.from_rotvec(attitude_noise * generator.normal(size=(len(path), 3)))
    return fields.reshape(len(path), -1) @ ARRAY.operator.T, reported.as_quat()
