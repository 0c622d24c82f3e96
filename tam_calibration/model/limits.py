"""What no measurement of an array goes beyond: a larger number is of another unit, or damage, and may overflow."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

LARGEST = {
    "time": 9.2e9,
    "readings": 1e9,
    "scalar": 1e9,
    "temperature": 1e4,
    "current": 1e6,
    "actuator": 1e6,
    "attitude": 10.0,
    "angular": 1e4,
    "position": 1e8,
}
"""Size of a value of each channel, SI. Nanoseconds in 64 bits end at 9.2e9 s, in the year 2262. A field in picotesla
that is taken for tesla is 5e7, and reported as such by the check of units. No sensor is as hot as 10 000 °C, and no
current near it a million amperes, and no array turns a thousand times a second; an actuator's angle, speed or power
is no larger in its unit. A quaternion has length 1, and drivers that do not divide by it are near that. No place is
farther than twice around the Earth."""


def largest_of(stream: str) -> float:
    """Return the size that no value of a stream goes beyond: of a channel, a further channel or a sensor."""
    return LARGEST.get("angular" if stream == "gyroscope" else stream.partition("_")[0], LARGEST["readings"])


LEAST_SPREAD_T = 1e-15
"""Of the readings of an axis that is turned in a field: the noise of the best SQUIDs alone is more."""

SHORTEST_ATTITUDE = 1e-3
"""Of at least one of the four numbers of a quaternion: of smaller ones the direction is rounding."""


@dataclass(frozen=True)
class Limits:
    """Between what sizes a quantity lies.

    Parameters
    ----------
    least, most : float
        Sizes, whatever the sign.
    unit : str
        Their unit, SI.
    """

    least: float
    most: float
    unit: str

    def require(self, name: str, values: float | FloatArray) -> None:
        """Check values.

        Parameters
        ----------
        name : str
            Of one of them, for the sentence.
        values : float or array
            NaN lies nowhere.

        Raises
        ------
        InputError
            When one lies beyond.
        """
        sizes = np.abs(np.ravel(values))
        beyond = sizes[~((sizes >= self.least) & (sizes <= self.most))]
        if len(beyond):
            raise InputError(
                f"{name} is {beyond[0]:g} {self.unit}, and lies within {self.least:g} to {self.most:g} {self.unit}: "
                "check the unit"
            )


LENGTH = Limits(0.0, 1e3, "m")
"""From the centre of an array to a sensor: vehicles carry arrays, and millimetres taken for metres make more."""

BASELINE = Limits(1e-4, 1e3, "m")
"""Between opposite sensors: those on one chip are a millimetre apart."""

NOISE = Limits(1e-35, 1e-3, "T")
"""Standard deviation of a reading: rounding to 64 bits makes 1e-21 T of the Earth's field, and its square must not be
lost to rounding; 1 mT is twenty times the field."""

DELAY = Limits(0.0, 60.0, "s")
"""Of a stamp: topics are joined within such a time."""

SPEED = Limits(0.0, 1e4, "m/s")
"""Of a platform, and of the error of its velocity: satellites make 8 km/s."""

ATTITUDE_NOISE = Limits(1e-6, 0.5, "rad")
"""Standard deviation of an attitude: star trackers are good to a second of arc, and beyond 30° it is none."""

RATE_NOISE = Limits(1e-10, 1e-1, "rad/s/√Hz")
"""Density of the noise of a gyroscope: ring lasers have 1e-7, the worst chips 1e-3."""

RATE_BIAS = Limits(1e-10, 10.0, "rad/s")
"""Standard deviation of the bias of a gyroscope: that of the worst chips is below 0.5 rad/s."""

RATE_SCALE = Limits(0.0, 0.3, "")
"""Standard deviation of the scale of a gyroscope: that of the worst chips is 0.05."""

MOUNTING_ERROR = Limits(0.0, 0.5, "rad")
"""Of how a sensor of attitude is mounted: what is not known to 30° is not known."""


def is_covariance(matrices: FloatArray) -> bool:
    """Return whether matrices (…, D, D) are symmetric and positive definite, but for rows of zeros, to rounding."""
    variance = np.diagonal(matrices, axis1=-2, axis2=-1)
    unknown = variance <= 0
    if ((unknown[..., None] | unknown[..., None, :]) & (matrices != 0)).any():
        return False
    deviation = np.sqrt(np.where(unknown, 1.0, variance))
    correlation = matrices / deviation[..., None] / deviation[..., None, :]
    skew = np.abs(correlation - np.swapaxes(correlation, -1, -2)).max(initial=0.0)
    # Part of a correlation that rounding of a covariance in a file may change: six digits are written at least.
    rounding = 1e-6
    return bool(skew <= rounding and np.linalg.eigvalsh(correlation).min(initial=0.0) >= -rounding)
