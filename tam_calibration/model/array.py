"""The sensor array: where its sensors sit, their noise, and what that makes of K readings."""

from dataclasses import dataclass, field, fields
from functools import cached_property

import numpy as np

from tam_calibration.model.data_sheet import ChangeRates, Gyroscope, Tolerances
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.geomagnetic_field import EARTH_FIELD, FieldBounds
from tam_calibration.model.limits import ATTITUDE_NOISE, BASELINE, DELAY, LENGTH, MOUNTING_ERROR, NOISE
from tam_calibration.model.mounting import NOT_TURNED, Mounting
from tam_calibration.model.recording import SampleSource, require_further, require_sensor_count
from tam_calibration.model.units import FloatArray

OUTPUT_NAMES = ("bx", "by", "bz", "gxx", "gxy", "gxz", "gyy", "gyz", "gzz")
"""The order of the nine outputs of an array: centre field, then the gradient tensor."""

TENSOR_OUTPUTS = (3, 4, 5, 6, 7)
"""Positions of the five independent tensor components xx, xy, xz, yy, yz among the outputs."""

TENSOR_ROWS, TENSOR_COLUMNS = np.array([[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]])
"""Row and column of these components in the tensor."""


def _unit_tensors() -> FloatArray:
    tensors = np.zeros((5, 3, 3))
    tensors[range(5), TENSOR_ROWS, TENSOR_COLUMNS] = tensors[range(5), TENSOR_COLUMNS, TENSOR_ROWS] = 1
    tensors[(0, 3), 2, 2] = -1
    return tensors


UNIT_TENSORS = _unit_tensors()
"""(5, 3, 3) symmetric, trace-free tensors in which one of xx, xy, xz, yy, yz is 1."""


def tensors_of(outputs: FloatArray) -> FloatArray:
    """Return the symmetric, trace-free tensors (N, 3, 3) of outputs (N, 8) or (N, 9); the ninth is not read."""
    return np.asarray(np.einsum("ni,ijk->njk", np.asarray(outputs)[:, 3:8], UNIT_TENSORS))


_ONE_FOR_ALL = ("vector_noise_T", "delay_s")
"""Values that may be stated as one number for all sensors."""


@dataclass(frozen=True, eq=False)
class Array:
    """Positions and noise of K tri-axial magnetometers and an optional scalar magnetometer.

    Parameters
    ----------
    positions_m : (K, 3) array
        Sensor positions in the array frame (x forward, y left, z up; origin at the centre), metres.
    vector_noise_T : (K,) array or float, optional
        Standard deviation of the white noise of each axis of each sensor, tesla; a float is used for all sensors.
        None means unknown: it is estimated from the recording.
    scalar_noise_T : float, optional
        Standard deviation of the scalar magnetometer's noise, tesla. None means unknown.
    scalar_position_m : (3,) array, optional
        Position of the scalar magnetometer in the array frame, metres; None means at the centre. It matters only
        if a fit includes a gradient of the ambient field.
    axis_offsets_m : (K, 3, 3) array, optional
        Places of the elements of axes x, y and z of each sensor relative to its position, metres, array frame. There
        is a row for each axis. None means all three at the position.
    field : FieldBounds
        Bounds on the intensity of the field.
    delay_s : (K,) array or float, optional
        Time from reading to stamp of each sensor, seconds; a float is used for all sensors. None means that stamps
        are correct.
    scalar_delay_s : float
        The same for the scalar magnetometer.
    mounting : Mounting
        Rotations of sensors and IMU against the array's axes. A recording is in the array's axes once it is read.
    change_rates : ChangeRates, optional
        How fast the errors of the sensors change; None means the defaults.
    attitude_noise : float, optional
        Standard deviation of the recorded attitude about each axis, radians, assuming white errors. Infinite means
        that it is estimated, None that a fit does not use the attitude.
    mounting_error : float, optional
        Standard deviation of the rotation of the attitude's frame against the array's about each axis, radians. None
        means that the rotation is unknown.
    further_channels : tuple of str
        Currents and actuators, in addition to ``current_A``, that the nodes listen to; see ``require_further``.
    tolerances : Tolerances, optional
        How large the errors of new sensors may be; None if nothing is known before a fit.
    gyroscope : Gyroscope, optional
        Noise and bias of the gyroscope; None if they are not stated.

    Raises
    ------
    InputError
        When a position or noise is not finite, not positive, has the wrong shape or is implausible (`limits`).

    Examples
    --------
    A cross with a baseline of half a metre and 1 nT of noise sees the gradient:

    >>> from tam_calibration import Array
    >>> cross = Array.cross(0.5, vector_noise_T=1e-9)
    >>> cross.positions_m.tolist()
    [[0.25, 0.0, 0.0], [0.0, 0.25, 0.0], [-0.25, 0.0, 0.0], [0.0, -0.25, 0.0]]
    >>> cross.has_gradient
    True

    Two sensors do not:

    >>> Array([[0.25, 0, 0], [-0.25, 0, 0]]).has_gradient
    False
    """

    positions_m: FloatArray
    vector_noise_T: FloatArray | None = None
    scalar_noise_T: float | None = None
    scalar_position_m: FloatArray | None = None
    axis_offsets_m: FloatArray | None = None
    field: FieldBounds = EARTH_FIELD
    delay_s: FloatArray | None = None
    scalar_delay_s: float = 0.0
    mounting: Mounting = NOT_TURNED
    change_rates: ChangeRates | None = None
    attitude_noise: float | None = None
    mounting_error: float | None = None
    further_channels: tuple[str, ...] = ()
    tolerances: Tolerances | None = None
    gyroscope: Gyroscope | None = None

    def __post_init__(self) -> None:
        """Check shapes and values."""
        positions = np.asarray(self.positions_m, dtype=float)
        if positions.ndim != 2 or positions.shape[0] < 1 or positions.shape[1] != 3:
            raise InputError(f"positions_m must be K rows of x, y, z; its shape is {positions.shape}")
        require_sensor_count(len(positions))
        if not np.isfinite(positions).all():
            raise InputError("positions_m contains a value that is not finite")
        object.__setattr__(self, "positions_m", positions)
        count = len(positions)
        for_each = f"for each of {count} sensors"
        for name, shape, needed in (
            ("vector_noise_T", (count,), f"vector noise needs one value {for_each}"),
            ("delay_s", (count,), f"delay_s needs one finite number {for_each}"),
            ("scalar_position_m", (3,), "the position of the scalar magnetometer must be three finite numbers x, y, z"),
            ("axis_offsets_m", (count, 3, 3), f"axis_offsets_m needs three rows of x, y, z {for_each}"),
        ):
            if (value := getattr(self, name)) is not None:
                array = np.asarray(value, dtype=float)
                if array.ndim == 0 and name in _ONE_FOR_ALL:
                    array = np.full(shape, array)
                if array.shape != shape:
                    raise InputError(f"{needed}, not the shape {array.shape}")
                if not np.isfinite(array).all():
                    raise InputError(f"{needed}, and contains one that is not finite")
                object.__setattr__(self, name, array)
        if self.vector_noise_T is not None and not (self.vector_noise_T > 0).all():
            raise InputError("every vector noise must be a positive number")
        if self.scalar_noise_T is not None and not (np.isfinite(self.scalar_noise_T) and self.scalar_noise_T >= 0):
            raise InputError("the scalar noise must be zero or a positive number")
        if not np.isfinite(self.scalar_delay_s):
            raise InputError(f"scalar_delay_s must be a finite number of seconds, not {self.scalar_delay_s}")
        self.mounting.require_sensors(len(positions))
        object.__setattr__(self, "further_channels", require_further(self.further_channels))
        self._check_sizes()

    def _check_sizes(self) -> None:
        attitude_noise = None if self.attitude_noise == np.inf else self.attitude_noise
        for name, limits, values in (
            ("the position of a sensor", LENGTH, self.positions_m),
            ("the noise of a sensor", NOISE, self.vector_noise_T),
            ("the noise of the scalar magnetometer", NOISE, self.scalar_noise_T or None),
            ("the position of the scalar magnetometer", LENGTH, self.scalar_position_m),
            ("the offset of an axis", LENGTH, self.axis_offsets_m),
            ("the delay of a sensor", DELAY, self.delay_s),
            ("the delay of the scalar magnetometer", DELAY, self.scalar_delay_s),
            ("the noise of the attitude", ATTITUDE_NOISE, attitude_noise),
            ("the error of the attitude's mounting", MOUNTING_ERROR, self.mounting_error),
        ):
            if values is not None:
                limits.require(name, values)

    @classmethod
    def cross(
        cls, baseline_m: float, vector_noise_T: float | None = None, scalar_noise_T: float | None = None
    ) -> "Array":
        """Make the four-sensor cross: sensors 1, 3 at +x, -x and 2, 4 at +y, -y, half a baseline out.

        Parameters
        ----------
        baseline_m : float
            Distance between opposite sensors, metres.
        vector_noise_T : float, optional
            Noise of each axis of all sensors, tesla; None means unknown.
        scalar_noise_T : float, optional
            Noise of the scalar magnetometer, tesla; None means unknown.

        Returns
        -------
        Array
            Of four sensors, the scalar magnetometer at the centre.

        Raises
        ------
        InputError
            When the baseline is not a positive number of metres, or not that of an array.
        """
        if not (np.isfinite(baseline_m) and baseline_m > 0):
            raise InputError(f"the baseline must be a positive number of metres, not {baseline_m}")
        BASELINE.require("the baseline", baseline_m)
        half = baseline_m / 2
        positions = np.array([[half, 0, 0], [0, half, 0], [-half, 0, 0], [0, -half, 0]])
        return cls(positions, None if vector_noise_T is None else np.array(vector_noise_T), scalar_noise_T)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return len(self.positions_m)

    @property
    def stamp_delay_s(self) -> FloatArray | None:
        """(K + 1,) delays of the stamps of the sensors, then the scalar, seconds; None where all stamps are true."""
        if self.delay_s is None and not self.scalar_delay_s:
            return None
        sensors = np.zeros(self.sensor_count) if self.delay_s is None else self.delay_s
        return np.append(sensors, self.scalar_delay_s)

    @cached_property
    def element_positions_m(self) -> FloatArray:
        """(K, 3, 3) positions of the elements of each sensor's axes x, y, z in the array frame, metres."""
        offsets = np.zeros((self.sensor_count, 3, 3)) if self.axis_offsets_m is None else self.axis_offsets_m
        return self.positions_m[:, None] + offsets

    @cached_property
    def has_gradient(self) -> bool:
        """Whether the geometry determines the five tensor components that a plane array can see."""
        return bool(np.linalg.matrix_rank(self.linear_field) == 8)

    @cached_property
    def linear_field(self) -> FloatArray:
        """(3K, 8) readings in a linear field, of its bx by bz gxx gxy gxz gyy gyz."""
        fields = np.broadcast_to(np.eye(3), (self.sensor_count, 3, 3))
        by_tensor = np.einsum("oij,kij->kio", UNIT_TENSORS, self.element_positions_m)
        return np.concatenate([fields, by_tensor], axis=2).reshape(-1, 8)

    @cached_property
    def operator(self) -> FloatArray:
        """(9, 3K) matrix from the stacked true fields at the sensors to the outputs.

        Rows in the order of ``OUTPUT_NAMES``. The gradient is the least-squares fit of a symmetric,
        trace-free tensor; for the cross it is Li 2018a eq. 2 with the mean of the two xy. Where the
        geometry does not determine it, the centre is the sensors' mean and the gradient rows are NaN.
        """
        operator = np.full((9, 3 * self.sensor_count), np.nan)
        if self.has_gradient:
            operator[:8] = np.linalg.pinv(self.linear_field)
            operator[8] = -operator[3] - operator[6]
        else:
            operator[:3] = np.tile(np.eye(3), self.sensor_count) / self.sensor_count
        return operator

    def with_noise(self, vector_noise_T: FloatArray, scalar_noise_T: float) -> "KnownNoiseArray":
        """Return the array with other noise.

        Parameters
        ----------
        vector_noise_T : (K,) array
            Of each axis of each sensor, tesla.
        scalar_noise_T : float
            Of the scalar magnetometer, tesla; 0 without one.

        Returns
        -------
        KnownNoiseArray
            The same geometry with this noise.
        """
        own = {each.name: getattr(self, each.name) for each in fields(self)}
        return KnownNoiseArray(**own | {"vector_noise_T": vector_noise_T, "scalar_noise_T": scalar_noise_T})

    def with_stated_noise(self) -> "KnownNoiseArray":
        """Return the array with its noise as stated; without a scalar magnetometer its noise is zero.

        Returns
        -------
        KnownNoiseArray
            The same geometry and noise.

        Raises
        ------
        InputError
            When the vector noise is not stated.
        """
        if self.vector_noise_T is None:
            raise InputError("the array's vector noise is not stated: add vector_noise_nT to the array file")
        return self.with_noise(self.vector_noise_T, self.scalar_noise_T or 0.0)

    def require_recording(self, recording: SampleSource) -> None:
        """Check that a recording has as many sensors as the array.

        Parameters
        ----------
        recording : SampleSource
            Raw readings.

        Raises
        ------
        InputError
            When it has not.
        """
        if recording.sensor_count != self.sensor_count:
            raise InputError(
                f"the recording has {recording.sensor_count} sensors, the array {self.sensor_count}: "
                "use the array file of this recording"
            )

    def has_geometry_of(self, other: "Array") -> bool:
        """Whether the other array has its sensors at the same places, to a micrometre, with the same rotations.

        Parameters
        ----------
        other : Array
            Which may have another number of sensors; its noise does not matter.

        Returns
        -------
        bool
            True where the element of each axis is at the same place, along the same axes.
        """
        return (
            self.positions_m.shape == other.positions_m.shape
            and bool(np.allclose(self.element_positions_m, other.element_positions_m, rtol=0, atol=1e-6))
            and self.mounting.turns_sensors_as(other.mounting)
        )


@dataclass(frozen=True, eq=False)
class KnownNoiseArray(Array):
    """An array every noise of which is known, be it stated or estimated: what fits, bounds and corrections need.

    Parameters
    ----------
    vector_noise_T : (K,) array
        As in ``Array``.
    scalar_noise_T : float
        As in ``Array``; 0 where there is no scalar magnetometer.
    """

    vector_noise_T: FloatArray = field()
    scalar_noise_T: float = field()
