"""What is simulated: array, errors, field, motion, channels and seed."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.further_channels import require_further
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray
from tam_calibration.simulation.attitude import Motion
from tam_calibration.simulation.instruments import AttitudeChannel, Current, ScalarReference, Temperature
from tam_calibration.simulation.sources import Drift
from tam_calibration.sources.dipole import Dipole

MOST_READINGS = 8_000_000
"""Of a simulated run, all sensors together: they take some 1.5 GiB."""


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
        The scalar magnetometer, where the array has it; None when there is none.
    temperature, current, attitude : optional
        Channels that are recorded beside the sensors.
    site_gradient_T_per_m : (3, 3) array, optional
        Gradient of the site's field, symmetric and trace-free, east, north, up, T/m.
    effects : tuple of FittedEffect
        Physical effects beyond the sensors' errors.
    further : mapping of str to Current
        Further currents and actuators by name, see ``further_channels``.

    Raises
    ------
    InputError
        When counts differ or a value is out of range.

    Examples
    --------
    Another seed draws other noise for the same run:

    >>> from dataclasses import replace
    >>> from tam_calibration import read_scenario, simulate
    >>> scenario = replace(read_scenario("wu_table_1"), seed=7)
    >>> simulate(scenario).recording.sample_count
    360
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
    site_gradient_T_per_m: FloatArray | None = None
    effects: tuple[FittedEffect, ...] = ()
    further: Mapping[str, Current] = field(default_factory=dict)

    def __post_init__(self) -> None:
        """Check counts, names and values."""
        require_further(self.further)
        sensors, errors = self.array.sensor_count, self.errors.sensor_count
        if sensors != errors:
            raise InputError(f"the scenario has errors of {errors} sensors and an array of {sensors}: make them match")
        if self.sample_count < 1:
            raise InputError(f"a scenario needs at least one sample, not {self.sample_count}")
        if self.sample_count * sensors > MOST_READINGS:
            raise InputError(
                f"a scenario has at most {MOST_READINGS // sensors} samples of {sensors} sensors, not "
                f"{self.sample_count}: simulate parts, each with a seed of its own"
            )
        if not (np.isfinite(self.rate_hz) and self.rate_hz > 0):
            raise InputError(f"the rate must be a positive number of samples per second, not {self.rate_hz}")
        gradient = self.site_gradient_T_per_m
        if gradient is not None:
            tolerance = 1e-9 * float(np.abs(gradient).max())
            if np.abs(gradient - gradient.T).max() > tolerance or abs(np.trace(gradient)) > tolerance:
                raise InputError("the gradient of the site's field must be symmetric, and its diagonal add up to zero")

    @property
    def time_s(self) -> FloatArray:
        """(N,) times of the samples from 0, seconds."""
        return np.arange(self.sample_count) / self.rate_hz
