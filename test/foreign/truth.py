"""The one simulated truth of the foreign recordings: a cross array that is turned in the Earth's field."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

SAMPLES = 1200
RATE_HZ = 25.0
START_S = 1_715_675_400.0
"""Unix time of the first sample, seconds: 2024-05-14 08:30:00 UTC."""

INTENSITY_T = 48.5e-6
DIRECTION = np.array([0.42, 0.03, 0.91])
"""Direction of the field in the world (north, east, down): inclination 65°, declination 4°."""

SCALAR_NOISE_T = 0.1e-9

SCALE_TOLERANCE = 0.05
"""Largest error of the common scale without a scalar magnetometer; the true scale factors are within 2 %."""


@dataclass(frozen=True, eq=False)
class Truth:
    """What K sensors read while the array turns.

    Parameters
    ----------
    sensor_count : int
        Number of sensors K.
    noise_T : float
        Standard deviation of each axis, tesla.
    has_scalar : bool
        Whether a scalar magnetometer is recorded.
    stagger_s : float
        How much later than the sensor before it each sensor is read.
    """

    sensor_count: int = 4
    noise_T: float = 1e-9
    has_scalar: bool = True
    stagger_s: float = 0.0

    @property
    def time_s(self):
        """(N,) times since the start."""
        return np.arange(SAMPLES) / RATE_HZ

    @property
    def sensor_time_s(self):
        """(N, K) times since the start at which each sensor is read."""
        return self.time_s[:, None] + self.stagger_s * np.arange(self.sensor_count)

    @property
    def gain(self):
        """(K, 3, 3) matrices from the field in the array frame to the readings without bias.

        Each is an upper triangular matrix of scale factors (2 %) and non-orthogonality (1°) times a misalignment (2°).
        Sensor 1 is not misaligned: its own axes make the array frame, as a uniform field determines no other.
        """
        rng = np.random.default_rng(7)
        scale = 1 + rng.uniform(-0.02, 0.02, (4, 3, 1))
        skew = np.triu(rng.uniform(-0.017, 0.017, (4, 3, 3)), 1)
        roll, pitch, yaw = rng.uniform(-0.035, 0.035, (3, 4)) * [0, 1, 1, 1]
        gain = scale * (np.eye(3) + skew) @ into_body(roll, pitch, yaw)
        return gain[: self.sensor_count]

    @property
    def bias_T(self):
        """(K, 3) readings in zero field."""
        return np.random.default_rng(8).uniform(-900e-9, 900e-9, (4, 3))[: self.sensor_count]

    @cached_property
    def field_T(self):
        """(N, K, 3) true field in the array frame when each sensor is read."""
        angles = attitude(self.sensor_time_s)
        world = intensity_T(self.sensor_time_s)[..., None] * DIRECTION / np.linalg.norm(DIRECTION)
        return np.einsum("nkij,nkj->nki", into_body(*angles), world)

    @cached_property
    def exact_T(self):
        """(N, K, 3) readings without noise."""
        return np.einsum("kij,nkj->nki", self.gain, self.field_T) + self.bias_T

    @cached_property
    def readings_T(self):
        """(N, K, 3) readings."""
        return self.exact_T + self.noise_T * np.random.default_rng(9).normal(size=self.exact_T.shape)

    @cached_property
    def scalar_T(self):
        """(N,) readings of the scalar magnetometer."""
        return intensity_T(self.time_s) + SCALAR_NOISE_T * np.random.default_rng(10).normal(size=SAMPLES)

    @cached_property
    def table_nT(self):
        """(N, 3K + 1) readings of the sensors and the scalar, nT."""
        return 1e9 * np.column_stack([self.readings_T.reshape(SAMPLES, -1), self.scalar_T])

    def misfit_T(self, calibration):
        """Return the (K,) root mean square distances between the true field and noise-free corrected readings.

        Without a scalar magnetometer a calibration knows the common scale to some percent only: it is fitted here.
        """
        unbiased = self.exact_T - calibration.errors.bias_T
        corrected = np.einsum("kij,nkj->nki", np.linalg.inv(calibration.errors.matrix), unbiased)
        scale = (corrected * self.field_T).sum() / (corrected**2).sum()
        if not self.has_scalar and abs(scale - 1) < SCALE_TOLERANCE:
            corrected *= scale
        return np.sqrt(((corrected - self.field_T) ** 2).sum(axis=2).mean(axis=0))


def intensity_T(time_s):
    """Return the intensity of the Earth's field, which drifts by 2 nT."""
    return INTENSITY_T + 1e-9 * np.sin(0.05 * time_s)


def attitude(time_s):
    """Return roll, pitch and yaw, radians, of a motion that turns the field through the whole sphere."""
    return 0.6 * time_s, 1.3 * np.sin(0.1 * time_s), 0.02 * time_s


def into_body(roll, pitch, yaw):
    """Return the matrices (..., 3, 3) that turn vectors of the world into the axes of the body."""
    return _about(0, roll) @ _about(1, pitch) @ _about(2, yaw)


def _about(axis, angle):
    matrix = np.zeros((*np.shape(angle), 3, 3))
    second, third = (axis + 1) % 3, (axis + 2) % 3
    matrix[..., axis, axis] = 1
    matrix[..., second, second] = matrix[..., third, third] = np.cos(angle)
    matrix[..., second, third] = np.sin(angle)
    matrix[..., third, second] = -np.sin(angle)
    return matrix


CROSS = Truth()
STAGGERED = replace(CROSS, stagger_s=0.2e-3)
AUTOPILOT = Truth(noise_T=50e-9, has_scalar=False, stagger_s=3e-3)
ARDUPILOT = Truth(sensor_count=3, noise_T=60e-9, has_scalar=False)
SINGLE = Truth(sensor_count=1, noise_T=5e-9, has_scalar=False)
