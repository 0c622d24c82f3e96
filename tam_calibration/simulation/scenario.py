"""What is simulated: array, errors, field, motion, channels and seed."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.array import Array
from tam_calibration.errors import SensorErrors
from tam_calibration.problems import InputError
from tam_calibration.simulation.attitude import Motion
from tam_calibration.simulation.channels import AttitudeChannel, Current, ScalarReference, Temperature
from tam_calibration.simulation.sources import Dipole, Drift
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Scenario:
    """A run to simulate.

    Parameters
    ----------
    array : Array
        Geometry and noise; a noise that is None is not simulated.
    errors : SensorErrors
        Of the array's sensors.
    site_field_T : (3,) array
        Uniform field east, north, up, tesla.
    motion : Motion
        What turns the array.
    sample_count : int
        Number of samples N.
    rate_hz : float
        Samples per second.
    seed : int
        Of all random numbers.
    drift : Drift, optional
        Of the uniform field.
    dipole : Dipole, optional
        A magnetic object near the array.
    scalar : ScalarReference, optional
        The scalar magnetometer at the array's centre; None when there is none.
    temperature, current, attitude : optional
        Channels that are recorded beside the sensors.

    Raises
    ------
    InputError
        When counts differ or a value is out of range.
    """

    array: Array
    errors: SensorErrors
    site_field_T: FloatArray
    motion: Motion
    sample_count: int
    rate_hz: float
    seed: int = 0
    drift: Drift | None = None
    dipole: Dipole | None = None
    scalar: ScalarReference | None = None
    temperature: Temperature | None = None
    current: Current | None = None
    attitude: AttitudeChannel | None = None

    def __post_init__(self) -> None:
        """Check counts and values."""
        sensors, errors = self.array.sensor_count, self.errors.sensor_count
        if sensors != errors:
            raise InputError(f"the scenario has errors of {errors} sensors and an array of {sensors}: make them match")
        if self.sample_count < 1:
            raise InputError(f"a scenario needs at least one sample, not {self.sample_count}")
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise InputError(f"the rate must be a positive number of samples per second, not {self.rate_hz}")

    @property
    def time_s(self) -> FloatArray:
        """(N,) times of the samples from 0, seconds."""
        return np.arange(self.sample_count) / self.rate_hz
