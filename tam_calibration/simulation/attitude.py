"""How the array is turned: attitudes over time, from the array frame to the world's east, north, up.

Each motion has ``attitudes(time_s, generator)``: (N,) times in seconds and the numpy generator of this motion to
(N, 4) quaternions x, y, z, w.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import quaternion_of
from tam_calibration.model.units import FloatArray, from_degrees

_GOLDEN_RATIO = (1 + np.sqrt(5)) / 2


class Motion(Protocol):
    """What turns the array."""

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the quaternions x, y, z, w from the array frame to the world.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        generator : numpy.random.Generator
            Random numbers of this motion.

        Returns
        -------
        (N, 4) array
            Unit quaternions, one for each time.
        """


@dataclass(frozen=True)
class RandomAttitudes:
    """Independent attitudes, uniform over all rotations: no direction of the field is preferred."""

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Only their number counts.
        generator : numpy.random.Generator
            Draws the attitudes.
        """
        quaternion = generator.standard_normal((len(time_s), 4))
        return np.asarray(quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True))


@dataclass(frozen=True)
class RandomEulerAngles:
    """Independent attitudes Rz Ry Rx of Gaussian angles: the random rotation of Wu 2025 section 4.1.

    Wu does not state the spread. From 90° on it hardly matters, and the residuals before calibration are his
    (1035, 1333, 762, 1684 nT and 8172 nT/m); uniform rotations would give others (937, 1423, 812, 1495 and 8429).

    Parameters
    ----------
    standard_deviation : float
        Of each angle, radians.
    """

    standard_deviation: float = np.pi

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Only their number counts.
        generator : numpy.random.Generator
            Draws the angles.
        """
        return quaternion_of(self.standard_deviation * generator.standard_normal((len(time_s), 3)))


@dataclass(frozen=True)
class ThreeAxisTurns:
    """One full turn in equal steps about x, then one about y, then one about z: the other rotation of Wu 2025 4.1."""

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Only their number counts: a third of the samples for each turn.
        generator : numpy.random.Generator
            Not used.
        """
        angles = np.zeros((len(time_s), 3))
        for axis, part in enumerate(np.array_split(np.arange(len(time_s)), 3)):
            angles[part, axis] = np.linspace(0, 2 * np.pi, len(part), endpoint=False)
        return quaternion_of(angles)


@dataclass(frozen=True)
class Turntable:
    """The 72 poses of the three-axis turntable of Wu 2025 section 4.2, the x axis innermost; in turn, then again."""

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Only their number counts: each sample is the next pose.
        generator : numpy.random.Generator
            Not used.
        """
        z, y, x = np.meshgrid([-90, -60, -30, 0], [0, 60, 120], [0, 60, 120, 180, 240, 300], indexing="ij")
        poses = quaternion_of(from_degrees(np.stack([x, y, z], axis=-1).reshape(-1, 3).astype(float)))
        return poses[np.arange(len(time_s)) % len(poses)]


@dataclass(frozen=True)
class Tumble:
    """A continuous tumble Rx Ry Rz at steady rates in golden ratio, so that no path repeats.

    Parameters
    ----------
    turn_rate : float
        About x, rad/s; about y and z it is less by the golden ratio and its square.
    """

    turn_rate: float = np.pi / 2

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds; at 0 the array is not turned.
        generator : numpy.random.Generator
            Not used.
        """
        from scipy.spatial.transform import Rotation

        rates = self.turn_rate / _GOLDEN_RATIO ** np.arange(3)
        return np.asarray(Rotation.from_euler("XYZ", np.outer(time_s, rates)).as_quat())


@dataclass(frozen=True)
class Manoeuvre:
    """Full circles of yaw with pitch and roll swinging between limits, as a vehicle under water can do it.

    Parameters
    ----------
    pitch_limit, roll_limit : float
        Largest angle, radians, below π/2.
    turn_period_s : float
        Duration of one full circle; pitch and roll swing faster, by the golden ratio and its square.

    Raises
    ------
    InputError
        When a limit lies outside 0 to 90 degrees or the period is not positive.
    """

    pitch_limit: float
    roll_limit: float
    turn_period_s: float

    def __post_init__(self) -> None:
        """Check the values."""
        if not (0 <= self.pitch_limit < np.pi / 2 and 0 <= self.roll_limit < np.pi / 2):
            raise InputError("pitch and roll limits must be at least 0 and less than 90 degrees")
        if not self.turn_period_s > 0:
            raise InputError(f"the period of a turn must be a positive number of seconds, not {self.turn_period_s}")

    def attitudes(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) quaternions x, y, z, w at times (N,).

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds; at 0 all angles are zero.
        generator : numpy.random.Generator
            Not used.
        """
        yaw = 2 * np.pi * time_s / self.turn_period_s
        pitch = self.pitch_limit * np.sin(_GOLDEN_RATIO * yaw)
        roll = self.roll_limit * np.sin(_GOLDEN_RATIO**2 * yaw)
        return quaternion_of(np.stack([roll, pitch, yaw], axis=1))
