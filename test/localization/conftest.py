from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.sources.poses import Poses

EARTH_T = np.array([1e-6, 2e-5, -4.5e-5])
GRADIENT_T_PER_M = 2e-9 * np.array([[0.3, 0.4, -0.2], [0.4, -0.9, 0.1], [-0.2, 0.1, 0.6]])
VELOCITY_M_PER_S = np.array([1.0, 0.0, 0.0])


def outputs_of(source, points_m=(0, 0, 0)):
    """Return the eight outputs of an array of no extent at a place."""
    point = np.asarray(points_m, dtype=float)
    return np.concatenate([source.field_T(point), source.gradient_T_per_m(point)[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]])


@dataclass(frozen=True)
class Course:
    """A platform that sways as it passes sources eastwards at 1 m/s from the origin, and what is about it.

    ``gradient`` is that of the regional field over ``GRADIENT_T_PER_M``, and ``velocity_error_m_per_s`` what the
    velocity has beside the reckoned one.
    """

    samples: int = 150
    noise_T: float = 1e-10
    attitude_noise: float = 0.0
    gradient: float = 1.0
    velocity_error_m_per_s: tuple = (0.0, 0.0, 0.0)

    @property
    def array(self):
        """Return the cross of half a metre."""
        return Array.cross(0.5, vector_noise_T=self.noise_T)

    @property
    def time_s(self):
        """Return times of a minute."""
        return np.arange(self.samples) * (60 / self.samples)

    @property
    def sway(self):
        """Return the true attitudes."""
        return Rotation.from_euler("zyx", 0.1 * np.sin(np.outer(self.time_s, [0.2, 0.33, 0.5]) + np.arange(3)))

    @property
    def path_m(self):
        """Return the reckoned places of the centre."""
        return np.outer(self.time_s, VELOCITY_M_PER_S)

    @property
    def points_m(self):
        """Return the true places (N, K, 3) of the sensors."""
        center = np.outer(self.time_s, VELOCITY_M_PER_S + self.velocity_error_m_per_s)
        return center[:, None] + np.einsum("nij,kj->nki", self.sway.as_matrix(), self.array.positions_m)

    def seen(self, sources, generator=None, bend_T=0.0):
        """Return the readings and the poses as they are reported; without a generator there are no errors.

        ``bend_T`` is a field (N, K, 3) of the world that is no source's.
        """
        world = EARTH_T + self.points_m @ (self.gradient * GRADIENT_T_PER_M) + bend_T
        for source in sources:
            world = world + source.field_T(self.points_m)
        fields = np.einsum("nji,nkj->nki", self.sway.as_matrix(), world)
        if generator is None:
            return fields, Poses(self.sway.as_quat(), self.path_m, self.attitude_noise)
        fields = fields + self.noise_T * generator.normal(size=fields.shape)
        errors = self.attitude_noise * generator.normal(size=(self.samples, 3))
        reported = (self.sway * Rotation.from_rotvec(errors)).as_quat()
        return fields, Poses(reported, self.path_m, self.attitude_noise)
