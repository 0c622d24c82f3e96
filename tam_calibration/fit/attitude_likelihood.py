"""Recorded attitude as data: the direction of the field that the sensors agree on against that of the world's field.

A sample's sensors agree on a field b in the array frame, of direction u; its attitude Q, through a mounting rotation X
from the array frame to that of the attitude, turns the direction w of the world's field to v = Xᵀ Qᵀ w there. The two
components of v across u are two more channels, white with the standard deviation of the attitude about each axis and
that of u: the third angle of an attitude, about the field, tells nothing.

The errors of the attitude are taken as independent from sample to sample. Those of a real one last: where they do for n
samples, state a standard deviation that is √n times as large.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.normal_equations import gram
from tam_calibration.fit.channel_maps import ChannelMaps
from tam_calibration.fit.likelihood import UNIFORM
from tam_calibration.fit.recorded_attitude import likely_turn
from tam_calibration.model.units import FloatArray

_PIECE = 8192


@dataclass(frozen=True, eq=False)
class WorldView:
    """How the attitude is mounted and where the world's field points.

    Parameters
    ----------
    mount : (3, 3) array
        X: from the array frame to that of the attitude.
    direction : (3,) array
        w: unit vector in the world.
    """

    mount: FloatArray
    direction: FloatArray

    @property
    def across(self) -> FloatArray:
        """(3, 2) unit vectors across the direction, along which it moves."""
        return np.linalg.qr(self.direction[:, None], mode="complete")[0][:, 1:]

    def moved(self, step: FloatArray) -> "WorldView":
        """Return the view after a step (5,): turn of the mount, radians, and shift of the direction across itself."""
        from scipy.spatial.transform import Rotation

        direction = self.direction + self.across @ step[3:]
        return WorldView(self.mount @ Rotation.from_rotvec(step[:3]).as_matrix(), direction / norm(direction))


@dataclass(frozen=True, eq=False)
class AttitudeLikelihood:
    """Samples whose attitude is known.

    Parameters
    ----------
    rows : (3 K, N) array
        Readings about an origin, in units of a field.
    to_world : (N, 3, 3) array
        Q: rotation matrices from the frame of the attitude to the world.
    vector_noise : (K,) array
        Standard deviation of each sensor's axes, in the same unit.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.
    """

    rows: FloatArray
    to_world: FloatArray
    vector_noise: FloatArray
    attitude_noise: float

    def view(self, matrix: FloatArray, bias: FloatArray) -> WorldView:
        """Return mounting and direction that agree with the readings corrected by matrices and biases."""
        channels = ChannelMaps.at(matrix, bias, UNIFORM, self.vector_noise, None)
        field = (channels.at_scalar[:, :-1] @ self.rows + channels.at_scalar[:, -1:]).T
        field /= norm(field, axis=1, keepdims=True)
        mount = likely_turn(field, self.to_world)
        direction = np.einsum("nij,nj->i", self.to_world, field @ mount.T)
        return WorldView(mount, direction / norm(direction))

    def linearize(self, matrix: FloatArray, bias: FloatArray, view: WorldView) -> tuple[FloatArray, FloatArray]:
        """Return the normal equations of the two channels of each sample.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        view : WorldView
            Mounting and direction.

        Returns
        -------
        (12 K + 5, 12 K + 5) array
            Information over the rows [D Λ | o] and the step of the view.
        (12 K + 5,) array
            Downhill.
        """
        channels = ChannelMaps.at(matrix, bias, UNIFORM, self.vector_noise, None)
        moments = np.zeros((18, 18))
        for start in range(0, self.rows.shape[1], _PIECE):
            part = slice(start, start + _PIECE)
            moments += gram(self._columns(channels, self.rows[:, part], self.to_world[part], view))
        count = 12 * len(matrix)
        response = np.zeros((count + 5, 17))
        response[:count, :12] = channels.response.reshape(count, 12)
        response[count:, 12:] = np.eye(5)
        return response @ moments[:17, :17] @ response.T, -response @ moments[:17, 17]

    def _columns(self, channels: ChannelMaps, rows: FloatArray, to_world: FloatArray, view: WorldView) -> FloatArray:
        """Return (18, 2 n) whitened columns across ⊗ [field, 1] / |field|, by mounting, by direction, residual."""
        field = channels.at_scalar[:, :-1] @ rows + channels.at_scalar[:, -1:]
        length = norm(field, axis=0)
        along = (field / length).T
        turned = to_world @ view.mount
        seen = np.einsum("nji,j->ni", turned, view.direction)
        covariance = channels.elimination.covariance
        of_field = (np.trace(covariance) - channels.elimination.variance_along(along.T)) / 2 / length**2
        root = 1 / np.sqrt(self.attitude_noise**2 + of_field)
        extended = np.concatenate([field / length, 1 / length[None]])
        by_direction = np.einsum("nji,jd->nid", turned, view.across)
        pairs = []
        for across in _across(along):
            columns = np.concatenate(
                [
                    (across.T[:, None] * extended).reshape(12, -1),
                    np.cross(across, seen).T,
                    np.einsum("ni,nid->dn", across, by_direction),
                    np.sum(across * seen, axis=1)[None],
                ]
            )
            pairs.append(columns * root)
        return np.concatenate(pairs, axis=1)


def _across(along: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return two unit vectors (N, 3) across each of unit vectors (N, 3)."""
    axis = np.eye(3)[np.abs(along).argmin(axis=1)]
    first = np.cross(along, axis)
    first /= norm(first, axis=1, keepdims=True)
    return first, np.cross(along, first)
