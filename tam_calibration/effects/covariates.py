"""Covariates: field, channels and attitude at each sample, of which effects are functions."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.recursions import Memory
from tam_calibration.model.array import Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_LARGEST_STEP = 3.0
"""Time step over the median from which it is a hole in the record."""


@dataclass(frozen=True, eq=False)
class Covariates:
    """Field, channels and attitude at each sample, as far as they are known.

    Parameters
    ----------
    time_s : (N,) array
        Time stamps, strictly increasing.
    field_T : (N, 3) array
        Field at the centre in the array frame: the truth in a simulation, the sensors' weighted mean in a diagnosis.
    errors : SensorErrors
        Of the sensors, in the same frame.
    array : Array
        Positions of the sensors.
    temperature_C, current_A : (N,) array, optional
        Channels, finite.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world, finite.
    memory : Memory, optional
        State of the recursions, where these samples continue others.
    follows_attitude : bool
        Whether the field is a constant one of the world, rotated by the attitude, and not made of readings.
    further : mapping of str to (N,) array
        Further currents and actuators by name, finite.
    """

    time_s: FloatArray
    field_T: FloatArray
    errors: SensorErrors
    array: Array
    temperature_C: FloatArray | None = None
    current_A: FloatArray | None = None
    attitude: FloatArray | None = None
    memory: Memory | None = None
    follows_attitude: bool = False
    further: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def sample_count(self) -> int:
        """Number of samples N."""
        return len(self.time_s)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return self.errors.sensor_count

    @property
    def scalar_row(self) -> int:
        """The row of the scalar magnetometer, 3 K."""
        return 3 * self.sensor_count

    @cached_property
    def sensed_T(self) -> FloatArray:
        """(N, 3K) readings without bias, tesla."""
        sensed: FloatArray = self.field_T @ self.errors.matrix.reshape(-1, 3).T
        return sensed

    @cached_property
    def intensity_T(self) -> FloatArray:
        """(N,) length of the field."""
        intensity: FloatArray = norm(self.field_T, axis=1)
        return intensity

    @cached_property
    def step_s(self) -> float:
        """Median step of time; 1 for a single sample."""
        return float(np.median(np.diff(self.time_s))) if self.sample_count > 1 else 1.0

    @cached_property
    def stretches(self) -> tuple[slice, ...]:
        """The samples between holes of the record."""
        cuts = np.flatnonzero(np.diff(self.time_s) > _LARGEST_STEP * self.step_s) + 1
        bounds = [0, *cuts.tolist(), self.sample_count]
        return tuple(slice(start, stop) for start, stop in pairwise(bounds))

    def take(self, index: slice | NDArray[Any]) -> "Covariates":
        """Return the covariates at the samples that a slice, mask or index selects."""
        channels = (self.temperature_C, self.current_A, self.attitude)
        temperature, current, attitude = (None if channel is None else channel[index] for channel in channels)
        return Covariates(
            self.time_s[index],
            self.field_T[index],
            self.errors,
            self.array,
            temperature,
            current,
            attitude,
            follows_attitude=self.follows_attitude,
            further={name: values[index] for name, values in self.further.items()},
        )


LEAST_TURN = 0.1
"""Least root mean square rotation of the array, or of the vertical in it, rad: noise of attitudes is smaller."""


def to_world(covariates: Covariates) -> FloatArray:
    """Return the (N, 3, 3) matrices that turn vectors of the array frame into the world's."""
    from scipy.spatial.transform import Rotation

    assert covariates.attitude is not None
    matrices: FloatArray = Rotation.from_quat(covariates.attitude).as_matrix()
    return matrices


def upwards(covariates: Covariates) -> FloatArray:
    """Return the (N, 3) direction upwards, against gravity, in the array frame."""
    return to_world(covariates)[:, 2]


def turn_spread(covariates: Covariates) -> float:
    """Return the root mean square angle, radians, by which the attitudes differ from their mean."""
    quaternion = covariates.attitude
    assert quaternion is not None
    unit = quaternion / np.linalg.norm(quaternion, axis=1, keepdims=True)
    # The largest eigenvalue is the mean square cosine of half the angles.
    missing = 1 - np.linalg.eigvalsh(unit.T @ unit / len(unit))[-1]
    return float(2 * np.arcsin(np.sqrt(np.clip(missing, 0, 1))))
