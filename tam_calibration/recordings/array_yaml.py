"""The array file: positions, rotations and noise of the sensors, with units in the keys, or frames to look up."""

from collections.abc import Callable
from dataclasses import field, replace
from functools import cache
from math import inf
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tam_calibration.files import schema
from tam_calibration.files.schema import Document, check, part_of, part_to_mapping, value_in_si, value_to_write
from tam_calibration.files.text_files import write_text
from tam_calibration.files.yaml_document import dump_mapping, mapping_in
from tam_calibration.messages.cdr import STATIC_TRANSFORMS, TransformTree
from tam_calibration.messages.point_cloud import FRAME_ID
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.mounting import Mounting, quaternion_of
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla
from tam_calibration.recordings.bag_storages import is_bag

_Vector = tuple[float, float, float]
_Quaternion = tuple[float, float, float, float]
_Offsets = tuple[_Vector, _Vector, _Vector]

LookUp = Callable[[str], tuple[FloatArray, FloatArray]]
"""From the name of a frame to its origin (3,), metres, and the quaternion (4,) of its axes, in the array's frame."""


class ArrayFile(Document):
    """What an array file may hold; a noise that is not stated is estimated from the recording.

    Parameters
    ----------
    baseline_m : float, optional
        Distance between opposite sensors of a four-sensor cross; either this or the positions.
    positions_m : list of [x, y, z], optional
        Positions in the array frame, x forward, y left, z up.
    vector_noise_nT : float or list of float, optional
        Noise of each axis, one for all sensors or one for each.
    scalar_noise_nT : float, optional
        Noise of the scalar magnetometer.
    scalar_position_m : [x, y, z], optional
        Where the scalar magnetometer sits when it is not at the centre.
    axis_offsets_m : list of three [x, y, z], optional
        For each sensor the places of the elements of its axes x, y and z relative to its position;
        ``tam calibrate --source`` finds them.
    intensity_nT : [low, high], optional
        What the intensity of the field can be in which the array is turned, where it is not the Earth's alone: that of
        a coil or a shielded room.
    delay_s : float or list of float, optional
        How much later than it was read a reading is stamped, s, one for all sensors or one for each;
        ``tam calibrate --estimate-delays`` finds them.
    scalar_delay_s : float, optional
        The same of the scalar magnetometer, whose messages must have stamps.
    rotations_deg : list of [roll, pitch, yaw], optional
        Of each sensor against the array: about the array's fixed axes x, y and z, one after the other (REP 103, URDF).
    rotations_quaternion : list of [x, y, z, w], optional
        The same; each turns vectors from the axes of a sensor into those of the array.
    imu_rotation_deg, imu_rotation_quaternion : optional
        The same of the IMU.
    frame_ids : list of str, optional
        ``frame_id`` of each sensor's messages. In a file without ``baseline_m`` and ``positions_m`` positions and
        rotations are those of these frames in tf.
    imu_frame_id : str, optional
        The same of the IMU.
    change_rates : mapping, optional
        How fast the errors of the sensors change: standard deviations by the day and by the kelvin, such as
        ``bias_nT_per_day``; those that are left out are those of survey fluxgates.
    tolerances : mapping, optional
        How far the errors of new sensors may be from none, as standard deviations: ``scale_factor_percent``,
        ``non_orthogonality_deg``, ``bias_nT`` and ``misalignment_deg``, of a data sheet and the mounting. Where they
        are stated they are known before a fit, unless a calibration is its prior.
    attitude_noise_deg : float or "estimate", optional
        Standard deviation of the recorded attitude about each axis; where it is stated, attitude is data of a fit. It
        must not come from an AHRS that uses these magnetometers.
    mounting_error_deg : float, optional
        Standard deviation of how the attitude's sensor is turned against the array, apart from what
        ``imu_rotation_deg`` states; left out where that turn may be any.
    gyroscope : mapping, optional
        Of the gyroscope: ``noise_mdps_per_sqrt_Hz`` and ``bias_deg_per_s``. A recorded angular velocity is data of a
        fit with it or without.
    further_channels : list of str, optional
        Currents and actuators in addition to ``current_A`` that the nodes subscribe to, such as ``current_2_A`` or
        ``actuator_rudder``.
    notes, recording
        Anything; not read.
    """

    baseline_m: float | None = None
    positions_m: list[_Vector] | None = None
    vector_noise_nT: float | list[float] | None = None
    scalar_noise_nT: float | None = None
    scalar_position_m: _Vector | None = None
    axis_offsets_m: list[_Offsets] | None = None
    intensity_nT: tuple[float, float] | None = None
    delay_s: float | list[float] | None = None
    scalar_delay_s: float = 0.0
    rotations_deg: list[_Vector] | None = None
    rotations_quaternion: list[_Quaternion] | None = None
    imu_rotation_deg: _Vector | None = None
    imu_rotation_quaternion: _Quaternion | None = None
    frame_ids: list[str] | None = None
    imu_frame_id: str | None = None
    change_rates: schema.RatesFile | None = None
    tolerances: schema.TolerancesFile | None = None
    attitude_noise_deg: float | Literal["estimate"] | None = None
    mounting_error_deg: float | None = None
    gyroscope: schema.GyroscopeFile | None = None
    further_channels: list[str] = field(default_factory=list)
    notes: Any = None
    recording: Any = None

    def located(self, look_up: LookUp | None) -> "ArrayFile":
        """Return the file with the positions and rotations that tf tells, where it leaves them to tf.

        Raises
        ------
        InputError
            When there is no tf, or the file states rotations of what it leaves to tf.
        """
        if not self.frame_ids or self.baseline_m is not None or self.positions_m is not None:
            return self
        if look_up is None:
            raise InputError(
                "it names frame_ids and no positions, which are then looked up in /tf_static: here state positions_m"
            )
        if self.rotations_deg or self.rotations_quaternion:
            raise InputError("it leaves positions to tf, which gives the rotations too: leave those out, or state both")
        poses = [look_up(frame) for frame in self.frame_ids]
        found: dict[str, Any] = {
            "positions_m": [position.tolist() for position, _ in poses],
            "rotations_quaternion": [rotation.tolist() for _, rotation in poses],
        }
        if self.imu_frame_id and not (self.imu_rotation_deg or self.imu_rotation_quaternion):
            found["imu_rotation_quaternion"] = look_up(self.imu_frame_id)[1].tolist()
        return replace(self, **found)

    def to_array(self) -> Array:
        """Return the array.

        Raises
        ------
        InputError
            When positions, rotations or noise make no array.
        """
        if (self.baseline_m is None) == (self.positions_m is None):
            raise InputError("give either baseline_m (the cross) or positions_m (a row of x, y, z for each sensor)")
        array = Array.cross(self.baseline_m) if self.baseline_m is not None else Array(np.array(self.positions_m))
        _require_apart(array.positions_m)
        if self.scalar_noise_nT == 0:
            raise InputError(
                "scalar_noise_nT must be greater than 0: leave it out where it is unknown or there is no scalar"
            )
        bounds = EARTH_FIELD if self.intensity_nT is None else FieldBounds(*from_nanotesla(np.array(self.intensity_nT)))

        def own(key: str) -> Any:
            return value_in_si(key, getattr(self, key))

        return Array(
            array.positions_m,
            own("vector_noise_nT"),
            own("scalar_noise_nT"),
            own("scalar_position_m"),
            own("axis_offsets_m"),
            bounds,
            own("delay_s"),
            self.scalar_delay_s,
            Mounting(
                _rotation_of("rotations", self.rotations_deg, self.rotations_quaternion),
                _rotation_of("imu_rotation", self.imu_rotation_deg, self.imu_rotation_quaternion),
                None if self.frame_ids is None else tuple(self.frame_ids),
                self.imu_frame_id,
            ),
            part_of(self.change_rates),
            inf if self.attitude_noise_deg == "estimate" else own("attitude_noise_deg"),
            own("mounting_error_deg"),
            tuple(self.further_channels),
            part_of(self.tolerances),
            part_of(self.gyroscope),
        )


def _require_apart(positions_m: FloatArray) -> None:
    for second, position in enumerate(positions_m, start=1):
        # No tri-axial magnetometer is smaller than a millimetre.
        near = np.flatnonzero(np.linalg.norm(positions_m[: second - 1] - position, axis=1) < 1e-3)
        if len(near):
            raise InputError(
                f"sensors {near[0] + 1} and {second} are both at {position.tolist()} m, where there is room for one: "
                "state where each sits"
            )


def _rotation_of(
    name: str, angles_deg: list[_Vector] | _Vector | None, quaternion: list[_Quaternion] | _Quaternion | None
) -> FloatArray | None:
    """Return quaternions, however they are stated.

    Raises
    ------
    InputError
        When they are stated twice.
    """
    if angles_deg is not None and quaternion is not None:
        raise InputError(f"give either {name}_deg or {name}_quaternion")
    if angles_deg is not None:
        return quaternion_of(from_degrees(np.array(angles_deg))) if angles_deg else np.zeros((0, 4))
    return None if quaternion is None else np.array(quaternion)


def read_array(path: str | Path, look_up: LookUp | None = None) -> Array:
    """Read an array file.

    Parameters
    ----------
    path : str or Path
        The YAML file: ``baseline_m`` of a cross or ``positions_m``, metres, and the noise in nT if known.
    look_up : callable, optional
        Returns positions and rotations if the file leaves them to tf.

    Returns
    -------
    Array
        In SI; a noise that the file does not state is None.

    Raises
    ------
    InputError
        When it cannot be read, a key is unknown, or the values do not describe an array.

    Examples
    --------
    >>> from pathlib import Path
    >>> from tam_calibration import read_array
    >>> written = Path("cross.yaml").write_text("{baseline_m: 0.5, vector_noise_nT: 1.0}")
    >>> array = read_array("cross.yaml")
    >>> array.sensor_count, array.vector_noise_T
    (4, array([1.e-09, 1.e-09, 1.e-09, 1.e-09]))
    """
    with mapping_in(Path(path)) as content:
        if {"array", "motion"} <= content.keys():
            raise InputError("it is a scenario: give the array file that tam simulate wrote with the recording")
        return check(content, ArrayFile).located(look_up).to_array()


def transforms_in(path: Path) -> LookUp:
    """Return what looks frames up in a recording, which is read when the first is asked for.

    Parameters
    ----------
    path : Path
        A bag with `/tf_static`; of a CSV file no frame is known.
    """
    tree_of = cache(_tree_of)

    def look_up(frame: str) -> tuple[FloatArray, FloatArray]:
        pose = tree_of(path).pose(frame, FRAME_ID)
        if pose is None:
            raise InputError(
                f"{path} has no {STATIC_TRANSFORMS} that leads from {FRAME_ID} to {frame}: state positions_m and "
                "rotations_deg in the array file"
            )
        return pose

    return look_up


def _tree_of(path: Path) -> TransformTree:
    tree = TransformTree()
    if is_bag(path):
        from tam_calibration.recordings.bag_reader import open_bag, raw_messages

        with open_bag(path) as reader:
            connections = [each for each in reader.connections if each.topic == STATIC_TRANSFORMS]
            for _, _, message in raw_messages(reader, connections) if connections else ():
                tree.add(message)
    return tree


def array_to_mapping(array: Array) -> dict[str, Any]:
    """Return the keys and values of an array file."""
    mounting = array.mounting
    content = {
        "positions_m": array.positions_m,
        "vector_noise_nT": array.vector_noise_T,
        "scalar_noise_nT": array.scalar_noise_T or None,
        "scalar_position_m": array.scalar_position_m,
        "axis_offsets_m": array.axis_offsets_m,
        "delay_s": array.delay_s,
        "scalar_delay_s": array.scalar_delay_s or None,
        "rotations_quaternion": mounting.rotations,
        "imu_rotation_quaternion": mounting.imu_rotation,
        "frame_ids": mounting.frame_ids and list(mounting.frame_ids),
        "imu_frame_id": mounting.imu_frame_id,
        "change_rates": part_to_mapping(array.change_rates),
        "tolerances": part_to_mapping(array.tolerances),
        "attitude_noise_deg": "estimate" if array.attitude_noise == inf else array.attitude_noise,
        "mounting_error_deg": array.mounting_error,
        "gyroscope": part_to_mapping(array.gyroscope),
        "further_channels": list(array.further_channels) or None,
        "intensity_nT": None if array.field == EARTH_FIELD else np.array([array.field.low_T, array.field.high_T]),
    }
    return {key: value_to_write(key, value) for key, value in content.items() if value is not None}


def write_array(path: Path, array: Array) -> None:
    """Write an array file.

    Parameters
    ----------
    path : Path
        The YAML file; one that is there is replaced once the new one is complete.
    array : Array
        Its positions are written in metres, its noise in nT where it is known.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    write_text(path, dump_mapping(array_to_mapping(array)))
