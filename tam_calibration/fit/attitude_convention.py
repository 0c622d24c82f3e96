"""How a recorded attitude may have been written otherwise: inverted, w first, in FRD axes, or not at all.

The right attitude turns the corrected field into one that stands still in the world. A constant turn of the world, such
as NED for ENU, cannot be seen, and does no harm. Where the stated attitude leaves the field turning and another reading
of the same numbers makes it stand still, the recording was written in that way.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.linalg import norm

from tam_calibration.fit.scale import sphere_center
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, from_degrees

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_TURNS = from_degrees(10.0)
"""Angle, root mean square, by which the field turns in the world of an attitude that is not the array's: near a source,
or with a compass on a vehicle, it turns by less."""

_BETTER = 4.0
"""How many times less it turns in that of the right one."""


_INVERSE, _SCALAR_FIRST = np.array([-1.0, -1.0, -1.0, 1.0]), [1, 2, 3, 0]
"""Signs of the inverse of a quaternion x, y, z, w, and the order that makes one of w, x, y, z."""

_HALF_TURNS = dict(zip("xyz", np.eye(4)[:3], strict=True))
"""Quaternions of the IMU against the array. That about x makes forward, right, down of forward, left, up. Readings with
that axis reversed in all sensors look the same, as the field may point either way."""


@dataclass(frozen=True)
class _Convention:
    """A way in which quaternions may be written, and what to do about it."""

    what: str
    remedy: str
    is_inverse: bool = False
    is_scalar_first: bool = False
    half_turn: str = ""

    def to_world(self, quaternions: FloatArray) -> "Rotation":
        """Return the turns from the array's axes to the world of quaternions that were written so."""
        ordered = quaternions[:, _SCALAR_FIRST] if self.is_scalar_first else quaternions
        from scipy.spatial.transform import Rotation  # takes as long to load as a calibration

        turns = Rotation.from_quat(ordered * _INVERSE if self.is_inverse else ordered)
        return turns * Rotation.from_quat(_HALF_TURNS[self.half_turn]) if self.half_turn else turns


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
    # 2000: by which an attitude is judged.
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
    if _BETTER * still < turning:
        return f"the recorded attitude {convention.what}: {convention.remedy}"
    turns = _AS_EXPECTED.to_world(attitude)
    constant = float((turns[0].inv() * turns).magnitude().max())
    if _BETTER * constant < turning:
        return "the recorded attitude hardly changes while the readings turn: look at its driver"
    return ""


def _turning(convention: _Convention, attitude: FloatArray, field: FloatArray) -> float:
    """Return the angle, root mean square, by which a field (N, 3) turns in the world, radians."""
    direction = field / norm(field, axis=1, keepdims=True)
    mean_length = float(norm(convention.to_world(attitude).apply(direction).mean(axis=0)))
    return float(np.sqrt(2 * max(1 - mean_length, 0.0)))
