"""Recorded attitude as data: the direction of the field that the sensors agree on against that of the world's field.

A sample's sensors agree on a field b in the array frame, of direction u; its attitude Q, through a mounting rotation X
from the array frame to that of the attitude, turns the direction w of the world's field to v = Xᵀ Qᵀ w there. The two
components of v across u are two more channels, white with the standard deviation of the attitude about each axis and
that of u: the third angle of an attitude, about the field, tells nothing.

The errors of the attitude are taken as independent from sample to sample; ``attitude_check`` measures how large they
are, and for how long they last.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.normal_equations import gram
from tam_calibration.fit.channel_maps import ChannelMaps
from tam_calibration.fit.likelihood import UNIFORM
from tam_calibration.fit.recorded_attitude import across_of, likely_turn
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.units import FloatArray

_PIECE = 8192

_VERTICAL = 1e-3
"""Sine of the angle to the vertical below which a direction has no heading."""


class AttitudeEquations(NamedTuple):
    """Normal equations of the attitude.

    Parameters
    ----------
    information : (P, P) array
        Over the unknowns.
    gradient : (P,) array
        Downhill.
    energy : float
        Sum of the squares of the whitened channels.
    channels : int
        Number of these.
    field_variance : float
        Mean variance of the direction of the field that the sensors agree on, radians squared.
    """

    information: FloatArray
    gradient: FloatArray
    energy: float
    channels: int
    field_variance: float

    def scatter(self, noise: float, taken: float = 0.0) -> float:
        """Return the standard deviation of attitude, radians, that the residuals show.

        Parameters
        ----------
        noise : float
            By which they were whitened, radians.
        taken : float
            Number of channels that the fit has taken.
        """
        variance = (noise**2 + self.field_variance) * self.energy / max(self.channels - taken, 1.0)
        # A scatter that is less than that of the field's direction is not told from none.
        variance = max(variance - self.field_variance, self.field_variance)
        return float(np.clip(np.sqrt(variance), ATTITUDE_NOISE.least, ATTITUDE_NOISE.most))


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
    uses_heading : bool
        Whether the heading counts. Without it only roll and pitch do: how steeply the field dips.
    """

    rows: FloatArray
    to_world: FloatArray
    vector_noise: FloatArray
    attitude_noise: float
    uses_heading: bool = True

    def part(self, samples: slice) -> "AttitudeLikelihood":
        """Return some of the samples."""
        return replace(self, rows=self.rows[:, samples], to_world=self.to_world[samples])

    def view(self, matrix: FloatArray, bias: FloatArray) -> WorldView:
        """Return mounting and direction that agree with the readings corrected by matrices and biases."""
        field = self.field(matrix, bias)
        mount = likely_turn(field, self.to_world)
        direction = np.einsum("nij,nj->i", self.to_world, field @ mount.T)
        return WorldView(mount, direction / norm(direction))

    def field(self, matrix: FloatArray, bias: FloatArray) -> FloatArray:
        """Return the directions (N, 3) of the field in the array frame, of sensors as of ``linearize``."""
        channels = ChannelMaps.at(matrix, bias, UNIFORM, self.vector_noise, None)
        field = (channels.at_scalar[:, :-1] @ self.rows + channels.at_scalar[:, -1:]).T
        return np.asarray(field / norm(field, axis=1, keepdims=True))

    def linearize(
        self, matrix: FloatArray, bias: FloatArray, view: WorldView, headings: FloatArray | None = None
    ) -> "AttitudeEquations":
        """Return the normal equations of the channels of each sample.

        Parameters
        ----------
        matrix : (K, 3, 3) array
            D Λ of each sensor.
        bias : (K, 3) array
            Of each sensor, in the unit of the readings.
        view : WorldView
            Mounting and direction.
        headings : (M, N) array, optional
            Errors of the heading, radians, whose sizes are M more unknowns.

        Returns
        -------
        AttitudeEquations
            Over the rows [D Λ | o], the step of the view, and the sizes of errors of the heading.
        """
        channels = ChannelMaps.at(matrix, bias, UNIFORM, self.vector_noise, None)
        headings = np.zeros((0, self.rows.shape[1])) if headings is None else headings
        more = len(headings)
        moments, variance = np.zeros((18 + more, 18 + more)), 0.0
        for start in range(0, self.rows.shape[1], _PIECE):
            part = slice(start, start + _PIECE)
            columns, own = self._columns(channels, self.rows[:, part], self.to_world[part], view, headings[:, part])
            moments += gram(columns)
            variance += own
        count = 12 * len(matrix)
        response = np.zeros((count + 5 + more, 17 + more))
        response[:count, :12] = channels.response.reshape(count, 12)
        response[count:, 12:] = np.eye(5 + more)
        return AttitudeEquations(
            response @ moments[:-1, :-1] @ response.T,
            -response @ moments[:-1, -1],
            float(moments[-1, -1]),
            (1 + self.uses_heading) * self.rows.shape[1],
            variance / self.rows.shape[1],
        )

    def _columns(
        self, channels: ChannelMaps, rows: FloatArray, to_world: FloatArray, view: WorldView, headings: FloatArray
    ) -> tuple[FloatArray, float]:
        """Return whitened columns (18 + M, 2 n), and the sum of the variances of the field's direction.

        They are across ⊗ [field, 1] / |field|, by mounting, by direction, by errors of the heading, residual.
        """
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
        up = to_world[:, 2] @ view.mount
        for across in np.moveaxis(across_of(along), 1, 0) if self.uses_heading else (_rising(along, up),):
            columns = np.concatenate(
                [
                    (across.T[:, None] * extended).reshape(12, -1),
                    np.cross(across, seen).T,
                    np.einsum("ni,nid->dn", across, by_direction),
                    headings * np.sum(across * np.cross(up, along), axis=1),
                    np.sum(across * seen, axis=1)[None],
                ]
            )
            pairs.append(columns * root)
        return np.concatenate(pairs, axis=1), float(of_field.sum())


def _rising(along: FloatArray, up: FloatArray) -> FloatArray:
    """Return the unit vectors (N, 3) across unit vectors along which these rise; zero where they are vertical."""
    rising = up - np.sum(up * along, axis=1, keepdims=True) * along
    return np.asarray(rising / np.maximum(norm(rising, axis=1, keepdims=True), _VERTICAL))
