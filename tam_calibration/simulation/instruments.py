"""The channels recorded with the tri-axial sensors: scalar magnetometer, temperature, current and attitude.

Each has ``readings``, which takes the times or the true values and the numpy generator of this channel.
"""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.units import FloatArray


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
        """Return the (N,) true temperatures at times (N,)."""
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
