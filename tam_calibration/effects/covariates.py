"""Covariates: field, channels and attitude at each sample, of which effects are functions.

Effects that remember are recursions over samples: first-order lags, x' = (drive - x) / τ, whose state goes from batch
to batch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


class Memory:
    """The states of the recursions of an effect's terms between batches of samples.

    Each batch runs the same recursions in the same order, so that they need no names: each recalls its state at the end
    of the previous batch, and keeps that for the next.
    """

    def __init__(self) -> None:
        self._kept: list[Any] = []
        self._turn = 0

    def rewind(self) -> None:
        """Begin a batch, at the first recursion."""
        self._turn = 0

    def recall(self) -> Any:
        """Return the state of the current recursion after the previous batch; None in the first batch."""
        return self._kept[self._turn] if self._turn < len(self._kept) else None

    def keep(self, value: Any) -> None:
        """Keep a state for the next batch, and go on to the next recursion."""
        self._kept[self._turn : self._turn + 1] = [value]
        self._turn += 1


_NO_LAG_S = 1e-9
"""Longest time constant that is none, seconds: samples are a microsecond apart at least."""


def lagged(drive: FloatArray, time_s: FloatArray, time_constant_s: float, memory: Memory | None = None) -> FloatArray:
    """Return a drive (N,) or (N, C) after a first-order lag, exact for a drive that is linear between samples.

    The lag is settled at the first sample, or goes on from where it stood in its memory; sample n depends on none
    after it.

    Parameters
    ----------
    drive : (N,) or (N, C) array
        Quantity that is lagged, in any unit.
    time_s : (N,) array
        Increasing times, seconds.
    time_constant_s : float
        Of the lag, seconds; up to a nanosecond there is no lag.
    memory : Memory, optional
        State after the previous batch of samples.
    """
    if time_constant_s <= _NO_LAG_S:
        return drive.copy()
    before = None if memory is None else memory.recall()
    if before is None:
        state = _lagged(drive, time_s, time_constant_s, drive[:1])
    else:
        last_time, last_drive, last_state = before
        values, times = np.concatenate([last_drive, drive]), np.concatenate([last_time, time_s])
        state = _lagged(values, times, time_constant_s, last_state)[1:]
    if memory is not None:
        memory.keep((time_s[-1:], drive[-1:], state[-1:]))
    return state


def _lagged(drive: FloatArray, time_s: FloatArray, time_constant_s: float, initial: FloatArray) -> FloatArray:
    values = drive.reshape(len(drive), -1)
    step = np.diff(time_s)[:, None]
    behind = time_constant_s * np.diff(values, axis=0) / step
    first = initial.reshape(-1)
    return follow(values[1:] - behind, values[:-1] - behind, first, step / time_constant_s).reshape(drive.shape)


def lagged_smooth(drive: FloatArray, rate: FloatArray, time_s: FloatArray, time_constant_s: float) -> FloatArray:
    """Return a drive (N, C) with known rates of change after a first-order lag, exact for cubics between samples.

    Right for time constants below the step of time too, which ``lagged`` takes for a lag of half a step.

    Parameters
    ----------
    drive : (N, C) array
        Quantity that is lagged, in any unit.
    rate : (N, C) array
        Its time derivative, per second.
    time_s : (N,) array
        Increasing times, seconds.
    time_constant_s : float
        Of the lag, seconds; up to a nanosecond there is no lag.
    """
    if time_constant_s <= _NO_LAG_S or len(drive) < 2:
        return drive.copy()
    return mode(drive, rate, time_s, time_constant_s)


def mode(drive: FloatArray, rate: FloatArray, time_s: FloatArray, tau: complex) -> NDArray[Any]:
    """Return x (N, C) of x' = (drive - x) / τ, settled at first, exact for cubics between samples.

    A complex time constant, of positive real part, is that of an oscillation.

    Parameters
    ----------
    drive : (N, C) array
        Quantity that drives the mode, in any unit.
    rate : (N, C) array
        Its time derivative, per second.
    time_s : (N,) array
        Increasing times, seconds.
    tau : complex
        Time constant τ, seconds.
    """
    step = np.diff(time_s)[:, None]
    slope = np.diff(drive, axis=0) / step
    first, last = rate[:-1], rate[1:]
    third = 6 * (first + last - 2 * slope) / step**2
    second = 2 * (3 * slope - 2 * first - last) / step
    second_at_end = second + third * step
    # A cubic p is followed by p - τ p' + τ² p'' - τ³ p''' and a transient.
    end = drive[1:] - tau * (last - tau * (second_at_end - tau * third))
    start = drive[:-1] - tau * (first - tau * (second - tau * third))
    return follow(end, start, drive[0] - tau * rate[0], step / tau)


def follow(end: NDArray[Any], start: NDArray[Any], initial: NDArray[Any], ratio: NDArray[Any]) -> NDArray[Any]:
    """Return x (N, C) of x_n = end_n + exp(-ratio_n) (x_{n-1} - start_n).

    Ends and starts are (N - 1, C), of the samples after the first; ratios the same or (N - 1, 1).

    Parameters
    ----------
    end, start : (N - 1, C) array
        Particular solution at the end and at the start of each step.
    initial : (C,) array
        State x at the first sample.
    ratio : (N - 1, C) or (N - 1, 1) array
        Exponent of the decay in each step; its real part is not negative.
    """
    decay = np.exp(-ratio)
    state = np.concatenate([initial[None], end - decay * start])
    if decay.shape[1] == 1:
        return _followed(state, decay[:, 0])
    return np.column_stack([_followed(*each) for each in zip(state.T, decay.T, strict=True)])


def _followed(added: NDArray[Any], decay: NDArray[Any]) -> NDArray[Any]:
    """Return x of x_n = decay_n x_{n-1} + added_n: the solution of equations of two diagonals."""
    from scipy.linalg.lapack import get_lapack_funcs

    diagonals = np.ones((2, len(added)), dtype=decay.dtype)
    diagonals[1, :-1] = -decay
    (solve,) = get_lapack_funcs(("tbtrs",), (diagonals, added))
    return np.asarray(solve(diagonals, added, uplo="L", diag="U")[0])


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

    @classmethod
    def of(cls, recording: Recording, field_T: FloatArray, errors: SensorErrors, array: Array) -> "Covariates":
        """Return the covariates of the samples of a recording, beside a field (N, 3) in the array frame, tesla."""
        channels = recording.temperature_C, recording.current_A, recording.attitude
        return cls(recording.time_s, field_T, errors, array, *channels, further=recording.further)

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
        return self.field_T @ self.errors.matrix.reshape(-1, 3).T

    @cached_property
    def intensity_T(self) -> FloatArray:
        """(N,) length of the field."""
        return np.asarray(norm(self.field_T, axis=1))

    @cached_property
    def step_s(self) -> float:
        """Median step of time; 1 for a single sample."""
        return float(np.median(np.diff(self.time_s))) if self.sample_count > 1 else 1.0

    @cached_property
    def stretches(self) -> tuple[slice, ...]:
        """The samples between holes of the record."""
        # A longer step than three median ones is a hole in the record.
        cuts = np.flatnonzero(np.diff(self.time_s) > 3.0 * self.step_s) + 1
        bounds = [0, *cuts.tolist(), self.sample_count]
        return tuple(slice(start, stop) for start, stop in pairwise(bounds))

    def take(self, index: slice | NDArray[Any]) -> "Covariates":
        """Return the covariates at the samples that a slice, mask or index selects."""
        values = {name: getattr(self, name) for name in ("time_s", "field_T", "temperature_C", "current_A", "attitude")}
        taken: dict[str, Any] = {name: value[index] for name, value in values.items() if value is not None}
        further = {name: channel[index] for name, channel in self.further.items()}
        return replace(self, memory=None, further=further, **taken)


LEAST_TURN = 0.1
"""Least root mean square rotation of the array, or of the vertical in it, rad: noise of attitudes is smaller."""


def to_world(covariates: Covariates) -> FloatArray:
    """Return the (N, 3, 3) matrices that turn vectors of the array frame into the world's."""
    from scipy.spatial.transform import Rotation

    assert covariates.attitude is not None
    return np.asarray(Rotation.from_quat(covariates.attitude).as_matrix())


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
