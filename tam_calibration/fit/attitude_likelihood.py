"""Recorded attitude as data: the direction of the field that the sensors agree on against that of the world's field.

A sample's sensors agree on a field b in the array frame, of direction u; its attitude Q, through a mounting rotation X
from the array frame to that of the attitude, turns the direction w of the world's field to v = Xᵀ Qᵀ w there. The two
components of v across u are two more channels, white with the standard deviation of the attitude about each axis and
that of u: the third angle of an attitude, about the field, tells nothing.

The errors of the attitude are taken as independent from sample to sample; ``attitude_check`` measures how large they
are, and for how long they last.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.normal_equations import Normal, gram
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.likelihood import ChannelMaps
from tam_calibration.fit.recorded_attitude import across_of, likely_turn
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.geomagnetic_field import LOCAL_STANDARD_ERROR_T
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_PIECE = 8192

_ANY_TURN = np.pi
"""Standard deviation of an angle of which nothing is known, radians: it keeps the normal equations regular."""


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

    size = 5
    """Unknowns: three of the turn of X, and two of the shift of w across itself."""

    turn = slice(0, 3)
    """Place of the turn of X among them."""

    @property
    def mounting(self) -> tuple[FloatArray, float]:
        """Rotation from the array frame to that of the attitude, and its turn over that of X."""
        return self.mount, 1.0

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
    headings : (M, N) array
        Errors of the heading, radians, whose sizes are M more unknowns, the last ones.
    """

    rows: FloatArray
    to_world: FloatArray
    vector_noise: FloatArray
    attitude_noise: float
    uses_heading: bool
    headings: FloatArray

    @classmethod
    def of(cls, data: Normalized, array: KnownNoiseArray, uses_heading: bool) -> "AttitudeLikelihood | None":
        """Return the samples with attitude, where the array states its noise."""
        if array.attitude_noise is None:
            return None
        recording = data.source.whole()
        if recording.attitude is None:
            return None
        from scipy.spatial.transform import Rotation

        known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
        rows = data.points[known].reshape(len(known), -1).T
        to_world = Rotation.from_quat(recording.attitude[known]).as_matrix()
        noise, none = array.vector_noise_T / data.radius_T, np.zeros((0, len(known)))
        return cls(rows, to_world, noise, array.attitude_noise, uses_heading, none)

    @property
    def sample_count(self) -> int:
        """Number of samples with attitude."""
        return len(self.to_world)

    def part(self, samples: slice) -> "AttitudeLikelihood":
        """Return some of the samples."""
        rows, headings = self.rows[:, samples], self.headings[:, samples]
        return replace(self, rows=rows, to_world=self.to_world[samples], headings=headings)

    def prior(self, view: WorldView, main_field_T: FloatArray | None) -> tuple[FloatArray, FloatArray]:
        """Return the precisions (5,) of the unknowns of a view before the samples, and the downhill gradient (5,).

        Parameters
        ----------
        view : WorldView
            Where the gradient is taken.
        main_field_T : (3,) array, optional
            Field of a model in the world, tesla; it tells the direction.
        """
        precisions, gradient = np.full(5, 1 / _ANY_TURN**2), np.zeros(5)
        if main_field_T is not None:
            length = float(norm(main_field_T))
            precisions[3:] += (own := (length / LOCAL_STANDARD_ERROR_T) ** 2)
            gradient[3:] += own * view.across.T @ main_field_T / length
        return precisions, gradient

    def start(self, errors: SensorErrors) -> WorldView:
        """Return the view by the errors about whose biases the readings are taken."""
        field = self.field(errors.matrix, np.zeros_like(errors.bias_T))
        mount = likely_turn(field, self.to_world)
        direction = np.einsum("nij,nj->i", self.to_world, field @ mount.T)
        return WorldView(mount, direction / norm(direction))

    def field(self, matrix: FloatArray, bias: FloatArray) -> FloatArray:
        """Return the directions (N, 3) of the field in the array frame, of sensors as of ``linearize``."""
        channels = ChannelMaps.of_uniform_field(matrix, bias, self.vector_noise)
        field = (channels.at_scalar[:, :-1] @ self.rows + channels.at_scalar[:, -1:]).T
        return np.asarray(field / norm(field, axis=1, keepdims=True))

    def linearize(self, matrix: FloatArray, bias: FloatArray, view: WorldView) -> Normal:
        """Return the normal equations of the channels of each sample.

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
        Normal
            Over the rows [D Λ | o], the step of the view, and the sizes of errors of the heading.
        """
        channels, moments, _ = self._moments(matrix, bias, view)
        return Normal.by_field(channels.response, moments, (1 + self.uses_heading) * self.sample_count)

    def scatter(self, matrix: FloatArray, bias: FloatArray, view: WorldView, taken: float = 0.0) -> float:
        """Return the standard deviation of attitude that the residuals show, radians.

        Parameters
        ----------
        matrix, bias, view
            As for ``linearize``.
        taken : float
            Number of channels that the fit has taken.
        """
        _, moments, of_field = self._moments(matrix, bias, view)
        channels = (1 + self.uses_heading) * self.sample_count
        variance = (self.attitude_noise**2 + of_field) * float(moments[-1, -1]) / max(channels - taken, 1.0)
        # A scatter that is less than that of the field's direction cannot be separated from none.
        variance = max(variance - of_field, of_field)
        return float(np.clip(np.sqrt(variance), ATTITUDE_NOISE.least, ATTITUDE_NOISE.most))

    def _moments(self, matrix: FloatArray, bias: FloatArray, view: WorldView) -> tuple[ChannelMaps, FloatArray, float]:
        """Return the maps, the moments of the whitened columns, and the mean variance of the field's direction."""
        channels = ChannelMaps.of_uniform_field(matrix, bias, self.vector_noise)
        size = 18 + len(self.headings)
        moments, variance = np.zeros((size, size)), 0.0
        for start in range(0, self.sample_count, _PIECE):
            columns, own = self.part(slice(start, start + _PIECE))._columns(channels, view)
            moments += gram(columns)
            variance += own
        return channels, moments, variance / self.sample_count

    def _columns(self, channels: ChannelMaps, view: WorldView) -> tuple[FloatArray, float]:
        """Return whitened columns (18 + M, 2 n), and the sum of the variances of the field's direction.

        They are across ⊗ [field, 1] / |field|, by mounting, by direction, by errors of the heading, residual.
        """
        field = channels.at_scalar[:, :-1] @ self.rows + channels.at_scalar[:, -1:]
        length = norm(field, axis=0)
        along = (field / length).T
        turned = self.to_world @ view.mount
        seen = np.einsum("nji,j->ni", turned, view.direction)
        covariance = channels.elimination.covariance
        of_field = (np.trace(covariance) - channels.elimination.variance_along(along.T)) / 2 / length**2
        root = 1 / np.sqrt(self.attitude_noise**2 + of_field)
        extended = np.concatenate([field / length, 1 / length[None]])
        by_direction = np.einsum("nji,jd->nid", turned, view.across)
        pairs = []
        up = self.to_world[:, 2] @ view.mount
        for across in np.moveaxis(across_of(along), 1, 0) if self.uses_heading else (_rising(along, up),):
            columns = np.concatenate(
                [
                    (across.T[:, None] * extended).reshape(12, -1),
                    np.cross(across, seen).T,
                    np.einsum("ni,nid->dn", across, by_direction),
                    self.headings * np.sum(across * np.cross(up, along), axis=1),
                    np.sum(across * seen, axis=1)[None],
                ]
            )
            pairs.append(columns * root)
        return np.concatenate(pairs, axis=1), float(of_field.sum())


def _rising(along: FloatArray, up: FloatArray) -> FloatArray:
    """Return the unit vectors (N, 3) across unit vectors along which these rise; zero where they are vertical."""
    rising = up - np.sum(up * along, axis=1, keepdims=True) * along
    # Sine of the angle to the vertical below which a direction has no heading.
    return np.asarray(rising / np.maximum(norm(rising, axis=1, keepdims=True), 1e-3))
