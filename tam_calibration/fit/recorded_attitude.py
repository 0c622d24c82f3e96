"""What recorded attitude adds to a fit: whether it was written as expected, and attitude as data.

An attitude may have been written otherwise: inverted, w first, in FRD axes, or not at all. The right attitude turns the
corrected field into one that is constant in the world. A constant turn of the world, such as NED for ENU, cannot be
seen, and does no harm. Where the stated attitude leaves the field turning and another reading of the same numbers makes
it constant, the recording was written in that way.

As data, the direction of the field that the sensors agree on is compared with that of the world's field. A sample's
sensors agree on a field b in the array frame, of direction u; its attitude Q, through a mounting rotation X from the
array frame to that of the attitude, turns the direction w of the world's field to v = Xᵀ Qᵀ w there. The two components
of v across u are two more channels, white with the standard deviation of the attitude about each axis and that of u:
the third angle of an attitude, about the field, tells nothing. The errors of the attitude are taken as independent from
sample to sample; ``attitude_check`` measures how large they are, and for how long they last.
"""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.field_alignment import likely_turn
from tam_calibration.core.least_squares import Normal, gram
from tam_calibration.fit.ellipsoid import Normalized, sphere_center
from tam_calibration.fit.likelihood import ChannelMaps
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.geomagnetic_field import LOCAL_STANDARD_ERROR_T
from tam_calibration.model.limits import ATTITUDE_NOISE
from tam_calibration.model.mounting import matrices_of, rotation_matrix
from tam_calibration.model.recording import BLOCK, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees, to_degrees

FRAME_STATEMENT = (
    "The array frame is the one whose attitude was recorded. It was found from the uniform field, "
    "which is constant in the world while the array turns."
)


def strayed(angle: float) -> str:
    """Return why attitudes in whose world the field turns by an angle, radians, are wrong; nothing if it is small."""
    if angle < _TURNS:
        return ""
    return (
        f"the field of the readings is not constant in the world of the attitude but turns by "
        f"{to_degrees(angle):.0f}°. Attitude must be the turn from the array to the world, x y z w, at the time of the "
        "sample"
    )


def across_of(along: FloatArray) -> FloatArray:
    """Return two unit vectors (N, 2, 3) across unit vectors (N, 3), right-handed with them as the third."""
    axis = np.eye(3)[np.abs(along).argmin(axis=1)]
    first = np.cross(along, axis)
    first /= norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(along, first)], axis=1)


_TURNS = from_degrees(10.0)
"""Angle, root mean square, by which the field turns in the world of an attitude that is not the array's: near a source,
or with a compass on a vehicle, it turns by less."""


@dataclass(frozen=True)
class _Convention:
    """A way in which quaternions may be written, and what to do about it.

    The half turn is that of the IMU against the array about an axis. About x it makes forward, right, down of forward,
    left, up. Readings with that axis reversed in all sensors look the same, as the field may point either way.
    """

    what: str
    remedy: str
    is_inverse: bool = False
    is_scalar_first: bool = False
    half_turn: str = ""

    def to_world(self, quaternions: FloatArray) -> Any:
        """Return the turns from the array's axes to the world of quaternions that were written so."""
        from scipy.spatial.transform import Rotation  # takes as long to load as a calibration

        turns = Rotation.from_quat(np.roll(quaternions, -1, axis=1) if self.is_scalar_first else quaternions)
        turns = turns.inv() if self.is_inverse else turns
        return turns * Rotation.from_euler(self.half_turn, np.pi) if self.half_turn else turns


_FRD = "state imu_rotation_deg: [180, 0, 0] in the array file"
_CONVENTIONS = (
    _Convention(
        "turns the world into the array", "write the inverse: reverse the signs of x, y and z", is_inverse=True
    ),
    _Convention("has its quaternions in the order w, x, y, z", "write them as x, y, z, w", is_scalar_first=True),
    _Convention(
        "turns the world into the array, and is in the order w, x, y, z",
        "write the inverse as x, y, z, w",
        is_inverse=True,
        is_scalar_first=True,
    ),
    _Convention(
        "is that of axes forward, right, down (NED), or axis x of all sensors is reversed", _FRD, half_turn="x"
    ),
    _Convention(
        "is that of axes forward, right, down (NED), and turns the world into the array",
        f"write the inverse, and {_FRD}",
        is_inverse=True,
        half_turn="x",
    ),
    *(
        _Convention(
            f"and the readings agree only where axis {axis} of all sensors is reversed, which are left-handed then, or "
            f"the IMU is turned by 180° about {axis}",
            f"reverse that axis in the driver, or state imu_rotation_deg about {axis} in the array file",
            half_turn=axis,
        )
        for axis in "yz"
    ),
)
_AS_EXPECTED = _Convention("", "")


def misread_attitude(recording: SampleSource, errors: SensorErrors | None = None) -> str:
    """Return how a recorded attitude was written otherwise than expected, and what to do; empty where it was not.

    Parameters
    ----------
    recording : SampleSource
        Raw readings, and attitude where there is one, x y z w from the array to the world.
    errors : SensorErrors, optional
        By which readings are corrected; without them those of sensor 1 count about the centre of their sphere.
    """
    # By which an attitude is judged.
    some = recording.thinned(2000).whole()
    if some.attitude is None:
        return ""
    known = np.isfinite(some.attitude).all(axis=1) & (norm(some.attitude, axis=1) > 0)
    if errors is None:
        field = some.readings_T[:, 0] - sphere_center(some.readings_T[:, 0])
    else:
        field = errors.restore(some.readings_T).mean(axis=1)
    field, attitude = field[known], some.attitude[known]
    if len(field) < 4 or (turning := _turning(_AS_EXPECTED, attitude, field)) < _TURNS:
        return ""
    still, convention = min(((_turning(each, attitude, field), each) for each in _CONVENTIONS), key=lambda one: one[0])
    # How many times less it turns in that of the right one.
    better = 4.0
    if better * still < turning:
        return f"the recorded attitude {convention.what}: {convention.remedy}"
    turns = _AS_EXPECTED.to_world(attitude)
    constant = float((turns[0].inv() * turns).magnitude().max())
    if better * constant < turning:
        return "the recorded attitude hardly changes while the readings turn: look at its driver"
    return ""


def _turning(convention: _Convention, attitude: FloatArray, field: FloatArray) -> float:
    """Return the angle, root mean square, by which a field (N, 3) turns in the world, radians."""
    direction = field / norm(field, axis=1, keepdims=True)
    mean_length = float(norm(convention.to_world(attitude).apply(direction).mean(axis=0)))
    return float(np.sqrt(2 * max(1 - mean_length, 0.0)))


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
        direction = self.direction + self.across @ step[3:]
        return WorldView(self.mount @ rotation_matrix(step[:3]), direction / norm(direction))


def is_attitude_data(recording: SampleSource, array: Array) -> bool:
    """Whether a recording has attitude, and its array states the noise of that, so that it counts as data."""
    return array.attitude_noise is not None and recording.whole().attitude is not None


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
        known = np.flatnonzero(np.isfinite(recording.attitude).all(axis=1))
        rows = data.points[known].reshape(len(known), -1).T
        to_world = matrices_of(recording.attitude[known])
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

    def start(self, matrix: FloatArray, bias: FloatArray) -> WorldView:
        """Return the view at which a fit begins, of sensors as of ``linearize``."""
        field = self.field(matrix, bias)
        mount = likely_turn(field, self.to_world)
        direction = np.einsum("nij,nj->i", self.to_world, field @ mount.T)
        return WorldView(mount, direction / norm(direction))

    def field(self, matrix: FloatArray, bias: FloatArray) -> FloatArray:
        """Return the directions (N, 3) of the field in the array frame, of sensors as of ``linearize``."""
        channels = ChannelMaps.at(matrix, bias, self.vector_noise)
        field = (channels.field[:, :-1] @ self.rows + channels.field[:, -1:]).T
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
        channels = ChannelMaps.at(matrix, bias, self.vector_noise)
        size = 18 + len(self.headings)
        moments, variance = np.zeros((size, size)), 0.0
        for start in range(0, self.sample_count, BLOCK):
            columns, own = self.part(slice(start, start + BLOCK))._columns(channels, view)
            moments += gram(columns)
            variance += own
        return channels, moments, variance / self.sample_count

    def _columns(self, channels: ChannelMaps, view: WorldView) -> tuple[FloatArray, float]:
        """Return whitened columns (18 + M, 2 n), and the sum of the variances of the field's direction.

        They are across ⊗ [field, 1] / |field|, by mounting, by direction, by errors of the heading, residual.
        """
        field = channels.field[:, :-1] @ self.rows + channels.field[:, -1:]
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
