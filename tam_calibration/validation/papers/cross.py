"""What the simulations of crosses in the papers have in common: the set-up, and the figures by which they judge."""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees

SENSORS = tuple(f"sensor {number}" for number in range(1, 5))
COMPONENTS = ("Bxx", "Bxy", "Bxz", "Byx", "Byy", "Byz")
"""The six components that Li 2018a and 2018b print, xy and yx apart."""


@dataclass(frozen=True, eq=False)
class SetUp:
    """A simulated cross in a uniform field.

    Parameters
    ----------
    array : Array
        Geometry and noise.
    baseline_m : float
        Distance of opposite sensors, metres.
    errors : SensorErrors
        The truth, in the frame of the platform.
    field_T : (N, 3) array
        True field in the frame of the platform, tesla.
    recording : Recording
        What is read.
    """

    array: Array
    baseline_m: float
    errors: SensorErrors
    field_T: FloatArray
    recording: Recording

    @property
    def intensity_T(self) -> float:
        """The constant intensity, tesla."""
        return float(norm(self.field_T[0]))

    def intensity_rms_T(self, fields_T: FloatArray) -> FloatArray:
        """Return the (4,) root mean square errors of the intensity of fields (N, 4, 3), tesla."""
        error = norm(fields_T, axis=2) - self.intensity_T
        rms: FloatArray = np.sqrt(np.mean(error**2, axis=0))
        return rms

    def tensor_T_per_m(self, fields_T: FloatArray) -> FloatArray:
        """Return the (N, 6) components ``COMPONENTS`` of fields (N, 4, 3), T/m."""
        along_x, along_y = fields_T[:, 0] - fields_T[:, 2], fields_T[:, 1] - fields_T[:, 3]
        difference = np.stack(
            [along_x[:, 0], along_y[:, 0], along_x[:, 2], along_x[:, 1], along_y[:, 1], along_y[:, 2]], axis=1
        )
        tensor: FloatArray = difference / self.baseline_m
        return tensor

    def tensor_rms_T_per_m(self, fields_T: FloatArray) -> FloatArray:
        """Return the (6,) root mean square components ``COMPONENTS`` of fields (N, 4, 3) in a uniform field, T/m."""
        rms: FloatArray = np.sqrt(np.mean(self.tensor_T_per_m(fields_T) ** 2, axis=0))
        return rms


def site_field(intensity_T: float, inclination_deg: float, declination_deg: float) -> FloatArray:
    """Return the field (3,) north, east, down of a site, tesla.

    Parameters
    ----------
    intensity_T : float
        Of the field, tesla.
    inclination_deg : float
        Degrees, positive downwards.
    declination_deg : float
        Degrees, positive to the east.
    """
    inclination, declination = from_degrees(inclination_deg), from_degrees(declination_deg)
    level = np.cos(inclination)
    direction = [level * np.cos(declination), level * np.sin(declination), np.sin(inclination)]
    field: FloatArray = intensity_T * np.array(direction)
    return field


def grid_of_turns(order: str, turns: int, field_T: FloatArray) -> FloatArray:
    """Return the fields (turns³, 3) in a frame turned about three axes in equal steps, the last axis fastest.

    Parameters
    ----------
    order : str
        The axes from left to right in the product of passive rotations, such as "ZYX".
    turns : int
        Steps in a full turn about each axis.
    field_T : (3,) array
        The field before.
    """
    from scipy.spatial.transform import Rotation

    steps = 2 * np.pi * np.arange(turns) / turns
    angles = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    fields: FloatArray = Rotation.from_euler(order, -angles).apply(field_T)
    return fields


def record(readings_T: FloatArray, intensity_T: float) -> Recording:
    """Return the recording of readings beside a constant scalar reading, one sample a second.

    Parameters
    ----------
    readings_T : (N, K, 3) array
        Raw readings, tesla.
    intensity_T : float
        The scalar reading of every sample, tesla.
    """
    count = len(readings_T)
    return Recording(np.arange(count, dtype=float), readings_T, np.full(count, intensity_T))
