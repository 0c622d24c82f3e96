"""How sensors and IMU are turned against the array, and their readings in the array's axes.

A rotation turns vectors from the axes of a sensor into those of the array. Roll, pitch and yaw are about the fixed axes
x, y and z, one after the other, as in REP 103, URDF and tf.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

_CONJUGATE = np.array([-1.0, -1.0, -1.0, 1.0])
"""Signs that make a unit quaternion x, y, z, w that of the opposite rotation."""

Turn = Callable[..., tuple[Any, ...]]
"""From the components of a vector or quaternion, numbers or arrays (N,), to those that it has in the array's axes."""


@dataclass(frozen=True, eq=False)
class Mounting:
    """The rotations of sensors and IMU against the array's axes, and the names of their frames.

    Parameters
    ----------
    rotations : (K, 4) array, optional
        Quaternion x, y, z, w of each sensor that turns its axes into the array's; None: all are the array's.
    imu_rotation : (4,) array, optional
        The same of the IMU.
    frame_ids : tuple of str, optional
        ``frame_id`` that the messages of each sensor must have.
    imu_frame_id : str, optional
        The same of the IMU.

    Raises
    ------
    InputError
        When a quaternion is no rotation.
    """

    rotations: FloatArray | None = None
    imu_rotation: FloatArray | None = None
    frame_ids: tuple[str, ...] | None = None
    imu_frame_id: str | None = None

    def __post_init__(self) -> None:
        """Check and normalise the quaternions."""
        if self.rotations is not None:
            rows = np.asarray(self.rotations, dtype=float)
            if rows.ndim != 2:
                raise InputError(f"the rotations must be a row for each sensor; their shape is {rows.shape}")
            names = [f"the rotation of sensor {sensor}" for sensor in range(1, len(rows) + 1)]
            object.__setattr__(self, "rotations", np.array(list(map(_unit, rows, names))).reshape(-1, 4))
        if self.imu_rotation is not None:
            rotation = _unit(np.asarray(self.imu_rotation, dtype=float), "the rotation of the IMU")
            object.__setattr__(self, "imu_rotation", rotation)

    def require_sensors(self, count: int) -> None:
        """Check that it is of so many sensors.

        Raises
        ------
        InputError
            When there are more or fewer rotations or frames.
        """
        for name, stated in (("rotations", self.rotations), ("frame_ids", self.frame_ids)):
            if stated is not None and len(stated) != count:
                raise InputError(f"{name} needs one for each of {count} sensors, not {len(stated)}")

    def turns_sensors_as(self, other: "Mounting") -> bool:
        """Whether the other has as many sensors with the same rotations; IMU and frame names do not matter."""
        none = np.array([0.0, 0.0, 0.0, 1.0])
        mine, others = (none if each.rotations is None else each.rotations for each in (self, other))
        difference = np.minimum(np.abs(mine - others).max(axis=-1), np.abs(mine + others).max(axis=-1))
        # Difference of quaternions up to which two rotations are one: some 2 µrad, far below what a sensor shows.
        return bool((difference < 1e-6).all())

    @cached_property
    def sensor_turns(self) -> dict[int, Turn]:
        """What turns a vector into the array's axes, for each sensor, from 0 on, that is turned."""
        rotations = () if self.rotations is None else self.rotations
        return {
            sensor: _vector_turn(rotation) for sensor, rotation in enumerate(rotations) if (rotation[:3] != 0).any()
        }

    @cached_property
    def attitude_turn(self) -> Turn | None:
        """What makes the IMU's attitude that of the array; None where it is turned as the array."""
        return None if self.imu_rotation is None else _attitude_turn(self.imu_rotation)

    @cached_property
    def rate_turn(self) -> Turn | None:
        """What turns the IMU's angular velocity into the array's axes; None where it is turned as the array."""
        return None if self.imu_rotation is None else _vector_turn(self.imu_rotation)

    @property
    def inverse(self) -> "Mounting":
        """What turns from the array's axes into those of sensors and IMU."""
        rotations, imu = (None if each is None else each * _CONJUGATE for each in (self.rotations, self.imu_rotation))
        return Mounting(rotations, imu)

    def turned(self, recording: Recording) -> Recording:
        """Return a recording along the axes of sensors and IMU along those of the array.

        Parameters
        ----------
        recording : Recording
            Of as many sensors, its attitude and angular velocity the IMU's.

        Returns
        -------
        Recording
            Its attitude and angular velocity are the array's.
        """
        if not (self.sensor_turns or self.attitude_turn):
            return recording
        readings, attitude, rates = recording.readings_T.copy(), recording.attitude, recording.angular_velocity_rad_s
        for sensor, turn in self.sensor_turns.items():
            readings[:, sensor] = np.column_stack(turn(*recording.readings_T[:, sensor].T))
        if attitude is not None and self.attitude_turn:
            attitude = np.column_stack(self.attitude_turn(*attitude.T))
        if rates is not None and self.rate_turn:
            rates = np.column_stack(self.rate_turn(*rates.T))
        return replace(recording, readings_T=readings, attitude=attitude, angular_velocity_rad_s=rates)


NOT_TURNED = Mounting()
"""Of an array whose sensors, and the IMU, are turned as it is."""


def quaternion_of(roll_pitch_yaw: FloatArray) -> FloatArray:
    """Return quaternions (…, 4) of roll, pitch and yaw (…, 3) about the fixed axes x, y, z, radians."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_euler("xyz", roll_pitch_yaw).as_quat())


def matrices_of(attitude: FloatArray) -> FloatArray:
    """Return the rotations (N, 3, 3) of quaternions (N, 4), NaN where they are unknown."""
    from scipy.spatial.transform import Rotation

    known = np.isfinite(attitude).all(axis=1)
    matrices = np.full((len(attitude), 3, 3), np.nan)
    if known.any():
        matrices[known] = Rotation.from_quat(attitude[known]).as_matrix()
    return matrices


def rotation_matrix(vector: FloatArray) -> FloatArray:
    """Return the rotation matrices (…, 3, 3) of rotation vectors (…, 3), radians; one of them, or N."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(vector).as_matrix())


def _unit(quaternion: FloatArray, name: str) -> FloatArray:
    """Return a quaternion of length 1.

    Raises
    ------
    InputError
        When it is no rotation.
    """
    length = np.linalg.norm(quaternion)
    # By how much the length of a quaternion may differ from 1: more than rounding to three digits makes of it.
    if quaternion.shape != (4,) or not abs(length - 1) <= 0.01:
        raise InputError(
            f"{name} is no rotation: {quaternion.tolist()}; a quaternion is x, y, z, w of length 1, angles are finite"
        )
    return quaternion / length


# Both are written out, so that numbers and arrays give the same bits, and a single reading costs a microsecond.


def _vector_turn(rotation: FloatArray) -> Turn:
    from scipy.spatial.transform import Rotation

    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = Rotation.from_quat(rotation).as_matrix().tolist()

    def turn(x: Any, y: Any, z: Any) -> tuple[Any, ...]:
        return xx * x + xy * y + xz * z, yx * x + yy * y + yz * z, zx * x + zy * y + zz * z

    return turn


def _attitude_turn(imu_rotation: FloatArray) -> Turn:
    """Return what multiplies an attitude by the inverse of the IMU's rotation."""
    ix, iy, iz, iw = (imu_rotation * _CONJUGATE).tolist()

    def turn(x: Any, y: Any, z: Any, w: Any) -> tuple[Any, ...]:
        return (
            x * iw + w * ix + y * iz - z * iy,
            y * iw + w * iy + z * ix - x * iz,
            z * iw + w * iz + x * iy - y * ix,
            w * iw - x * ix - y * iy - z * iz,
        )

    return turn
