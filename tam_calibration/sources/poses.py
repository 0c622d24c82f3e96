"""Where the array was, and how it was turned."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the array was, N times.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w that turn vectors of the array frame into the world's.
    position_m : (N, 3) array
        Of the array's centre in the world, metres.
    attitude_noise : float
        Standard deviation of the attitude's error about each axis, radians; it is common to all sensors of a pose and
        turns the whole field.

    Raises
    ------
    InputError
        When a shape is wrong or a value is not finite.
    """

    attitude: FloatArray
    position_m: FloatArray
    attitude_noise: float = 0.0

    def __post_init__(self) -> None:
        """Check shapes and values."""
        count = len(self.attitude)
        if np.shape(self.attitude) != (count, 4) or np.shape(self.position_m) != (count, 3):
            raise InputError(
                "poses need N quaternions x, y, z, w and N positions x, y, z, not the shapes "
                f"{np.shape(self.attitude)} and {np.shape(self.position_m)}"
            )
        if not (np.isfinite(self.attitude).all() and np.isfinite(self.position_m).all()):
            raise InputError("a pose is not finite: leave out the samples without attitude or position")

    @classmethod
    def headings(cls, attitude: FloatArray) -> "Poses":
        """Return the poses of an array that was turned about its centre, which is the origin of the world."""
        return cls(np.asarray(attitude, dtype=float), np.zeros((len(attitude), 3)))

    @property
    def matrix(self) -> FloatArray:
        """(N, 3, 3) rotations from the array frame to the world."""
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_quat(self.attitude).as_matrix())
