"""The conditions of a simulated run: how the array turns, the channels recorded with it, and the field of the site.

Each motion has ``attitudes(time_s, generator)``: (N,) times in seconds and the numpy generator of this motion to
(N, 4) quaternions x, y, z, w, from the array frame to the world's east, north, up. Each channel has ``readings``, which
takes the times or the true values and its numpy generator. Fields are in the world's east, north, up; a magnetic object
is a ``sources.dipole.Dipole``.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import quaternion_of
from tam_calibration.model.units import FloatArray, from_degrees


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
        from scipy.constants import golden
        from scipy.spatial.transform import Rotation

        rates = self.turn_rate / golden ** np.arange(3)
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
        from scipy.constants import golden

        yaw = 2 * np.pi * time_s / self.turn_period_s
        pitch = self.pitch_limit * np.sin(golden * yaw)
        roll = self.roll_limit * np.sin(golden**2 * yaw)
        return quaternion_of(np.stack([roll, pitch, yaw], axis=1))


@dataclass(frozen=True)
class ScalarReference:
    """The scalar magnetometer at the array's centre.

    Parameters
    ----------
    rate_hz : float, optional
        Readings per second, at most the sensors' rate; None for one in every sample.
    one_error_per_recording : bool
        Whether the noise is one draw for the complete recording, as Wu 2025 Fig. 6 needs it, and not one per reading.
    """

    rate_hz: float | None = None
    one_error_per_recording: bool = False

    def readings(
        self, time_s: FloatArray, intensity_T: FloatArray, noise_T: float, generator: np.random.Generator
    ) -> FloatArray:
        """Return the (N,) readings, tesla; NaN in samples without a reading.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        intensity_T : (N,) array
            True intensity at each sample, tesla.
        noise_T : float
            Standard deviation of the noise, tesla.
        generator : numpy.random.Generator
            Draws the noise.
        """
        noise = generator.normal(0, noise_T, 1 if self.one_error_per_recording else len(time_s))
        readings = intensity_T + noise
        if self.rate_hz is not None:
            due = np.floor((time_s - time_s[0]) * self.rate_hz + 1e-9)
            readings[np.diff(due, prepend=-1) == 0] = np.nan
        return readings


@dataclass(frozen=True)
class Temperature:
    """A temperature that changes steadily.

    Parameters
    ----------
    start_C, end_C : float
        At the first and the last sample, degrees Celsius.
    noise_C : float
        Standard deviation of the reading.
    """

    start_C: float
    end_C: float
    noise_C: float = 0.0

    def course(self, time_s: FloatArray) -> FloatArray:
        """Return the (N,) true temperatures at times (N,), of which only the number counts."""
        return np.linspace(self.start_C, self.end_C, len(time_s))

    def readings(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N,) temperatures read, degrees Celsius.

        Parameters
        ----------
        time_s : (N,) array
            Only their number counts: the temperature changes evenly from sample to sample.
        generator : numpy.random.Generator
            Draws the noise.
        """
        return self.course(time_s) + generator.normal(0, self.noise_C, len(time_s))


@dataclass(frozen=True)
class Current:
    """A current that is switched on and off: low for half a period, then high; so may an actuator, in its own unit.

    Parameters
    ----------
    low_A, high_A : float
        The two levels, ampere.
    period_s : float
        Duration of both together.
    noise_A : float
        Standard deviation of the reading.
    """

    low_A: float
    high_A: float
    period_s: float
    noise_A: float = 0.0

    def course(self, time_s: FloatArray) -> FloatArray:
        """Return the (N,) true currents at times (N,)."""
        return np.where(time_s % self.period_s < self.period_s / 2, self.low_A, self.high_A)

    def readings(self, time_s: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N,) currents read, ampere.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        generator : numpy.random.Generator
            Draws the noise.
        """
        return self.course(time_s) + generator.normal(0, self.noise_A, len(time_s))


@dataclass(frozen=True)
class AttitudeChannel:
    """The attitude as a navigation system reports it.

    Parameters
    ----------
    noise : float
        Standard deviation of the error about each axis of the array, radians.
    """

    noise: float = 0.0

    def readings(self, attitude: FloatArray, generator: np.random.Generator) -> FloatArray:
        """Return the (N, 4) reported quaternions x, y, z, w.

        Parameters
        ----------
        attitude : (N, 4) array
            True quaternions x, y, z, w from the array frame to the world.
        generator : numpy.random.Generator
            Draws the errors.
        """
        from scipy.spatial.transform import Rotation

        error = Rotation.from_rotvec(generator.normal(0, self.noise, (len(attitude), 3)))
        return np.asarray((Rotation.from_quat(attitude) * error).as_quat())


def field_from_elements(intensity_T: float, inclination: float, declination: float) -> FloatArray:
    """Return the (3,) field east, north, up, tesla.

    Parameters
    ----------
    intensity_T : float
        Of the field, tesla.
    inclination : float
        Radians, positive downwards.
    declination : float
        Radians, positive to the east.
    """
    north = np.cos(inclination) * np.cos(declination)
    east = np.cos(inclination) * np.sin(declination)
    return intensity_T * np.array([east, north, -np.sin(inclination)])


class Drift(Protocol):
    """How the uniform field of the site changes with time."""

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, east, north, up, tesla.
        """


@dataclass(frozen=True)
class SinusoidDrift:
    """An intensity that swings as a sinusoid about the site's.

    Parameters
    ----------
    standard_deviation_T : float
        Of the intensity over the samples, tesla.
    period_s : float
        Duration of one swing, seconds.
    """

    standard_deviation_T: float
    period_s: float

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, along which it changes, tesla.
        """
        return _along(site_field_T, np.sin(2 * np.pi * time_s / self.period_s), self.standard_deviation_T)


@dataclass(frozen=True)
class RampDrift:
    """An intensity that rises steadily about the site's.

    Parameters
    ----------
    standard_deviation_T : float
        Of the intensity over the samples, tesla.
    """

    standard_deviation_T: float

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, along which it changes, tesla.
        """
        return _along(site_field_T, time_s, self.standard_deviation_T)


@dataclass(frozen=True, eq=False)
class ObservedDrift:
    """The variation that an observatory recorded about its mean, turned from its magnetic meridian into the site's.

    Parameters
    ----------
    time_s : (M,) array
        Times of the record, increasing; 0 is the start of the simulation.
    field_T : (M, 3) array
        Components to magnetic north, magnetic east and down, tesla; NaN where the record has a gap.
    """

    time_s: FloatArray
    field_T: FloatArray

    def variation_T(self, time_s: FloatArray, site_field_T: FloatArray) -> FloatArray:
        """Return what is added to the field of the site, (N, 3) east, north, up, tesla.

        Parameters
        ----------
        time_s : (N,) array
            Times of the samples, seconds.
        site_field_T : (3,) array
            Uniform field of the site, east, north, up, tesla; its level part gives the magnetic meridian.

        Raises
        ------
        InputError
            When the record has a gap in the time of the simulation, or does not span it.
        """
        columns = [np.interp(time_s, self.time_s, column, left=np.nan, right=np.nan) for column in self.field_T.T]
        north, east, down = np.array(columns) - np.mean(columns, axis=1, keepdims=True)
        if not np.isfinite(north + east + down).all():
            span = time_s[-1] - time_s[0]
            raise InputError(
                f"the observatory's record has a gap within the {span:.0f} s of the simulation, or does not span them: "
                "choose another start or fewer samples"
            )
        meridian = np.arctan2(site_field_T[0], site_field_T[1])
        cosine, sine = np.cos(meridian), np.sin(meridian)
        return np.stack([north * sine + east * cosine, north * cosine - east * sine, -down], axis=1)


def _along(site_field_T: FloatArray, shape: FloatArray, standard_deviation_T: float) -> FloatArray:
    """Return the (N, 3) variation along the site field that has the shape (N,) and exactly the standard deviation."""
    if np.ptp(shape) == 0:
        raise InputError("one sample cannot drift: ask for more samples or for no drift")
    intensity = standard_deviation_T * (shape - shape.mean()) / shape.std()
    return np.outer(intensity, site_field_T / norm(site_field_T))
