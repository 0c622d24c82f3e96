"""Covariates: field, motion, channels and attitude at each sample, of which effects are functions."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.effects.grades import NOTABLE
from tam_calibration.effects.recursions import Memory
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.recording import BLOCK, Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

LEAST_TURN = 0.1
"""Least root mean square rotation of the array, or of the vertical in it, rad: noise of attitudes is smaller."""


class _Further(dict[str, FloatArray]):
    """Further channels by name; it says in a sentence that one is not there."""

    def __missing__(self, name: str) -> FloatArray:
        raise InputError(f"there is no channel {quoted(name)}: an effect that follows it must name it in its channels")


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

    def __post_init__(self) -> None:
        """Make a further channel that is missing a sentence."""
        object.__setattr__(self, "further", _Further(self.further))

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

    def channel(self, name: str) -> FloatArray:
        """Return a channel (N, ...) that is recorded, by its name, a further one too."""
        value = getattr(self, name, None)
        return self.further[name] if value is None else np.asarray(value)

    @cached_property
    def sensed_T(self) -> FloatArray:
        """(N, 3K) readings without bias, tesla."""
        return self.field_T @ self.errors.matrix.reshape(-1, 3).T

    @property
    def read_T(self) -> FloatArray:
        """(N, 3K) readings, tesla."""
        return self.sensed_T + self.errors.bias_T.ravel()

    @cached_property
    def intensity_T(self) -> FloatArray:
        """(N,) length of the field."""
        return np.asarray(norm(self.field_T, axis=1))

    @property
    def direction(self) -> FloatArray:
        """(N, 3) unit vectors along the field."""
        return self.field_T / self.intensity_T[:, None]

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

    @cached_property
    def rate_T_per_s(self) -> FloatArray:
        """(N, 3) derivative of the field by time, per stretch between holes.

        That of the polynomial through three neighbours on both sides, at an end of a stretch through the nearest six; a
        sample's own noise is not in its derivative. Zero in stretches of less than three samples.
        """
        rate = np.zeros_like(self.field_T)
        for stretch in self.stretches:
            if stretch.stop - stretch.start < 3:
                continue
            neighbours, here = _neighbours(stretch), np.arange(stretch.start, stretch.stop)
            for first_of_piece in range(0, len(here), BLOCK):
                nodes, own = neighbours[first_of_piece:][:BLOCK], here[first_of_piece:][:BLOCK]
                _, slope = _weights(self.time_s[nodes] - self.time_s[own, None])
                # A larger weight of a neighbour, per time step, means samples that nearly coincide.
                wild = np.abs(slope).max(axis=1) * self.step_s > 50.0
                slope[wild] = 0
                rate[own] = _combined(slope, self.field_T[nodes])
        return rate

    @property
    def sensed_rate_T_per_s(self) -> FloatArray:
        """(N, 3K) derivative of what each axis senses by time."""
        return self.rate_T_per_s @ self.errors.matrix.reshape(-1, 3).T

    @cached_property
    def splines(self) -> list[tuple[slice, Any]]:
        """The stretches of more than one sample, and the spline through the field in each."""
        from scipy.interpolate import CubicSpline

        stretches = [stretch for stretch in self.stretches if stretch.stop - stretch.start > 1]
        return [(stretch, CubicSpline(self.time_s[stretch], self.field_T[stretch])) for stretch in stretches]

    def take(self, index: slice | NDArray[Any]) -> "Covariates":
        """Return the covariates at the samples that a slice, mask or index selects."""
        values = {name: getattr(self, name) for name in ("time_s", "field_T", "temperature_C", "current_A", "attitude")}
        taken: dict[str, Any] = {name: value[index] for name, value in values.items() if value is not None}
        further = {name: channel[index] for name, channel in self.further.items()}
        return replace(self, memory=None, further=further, **taken)


NEIGHBOURS = 6
"""Samples on both sides through which a polynomial (of fifth degree) predicts one, as turns are smooth."""


def jumps(covariates: Covariates) -> str | None:
    """Return that the field changes from sample to sample in jumps, not in continuous motion, where it does."""
    if covariates.sample_count < 2 * NEIGHBOURS:
        return f"{covariates.sample_count} samples are too few to tell a motion"
    # Means of several samples have less noise, which a slow motion needs.
    for size in (1, 2, 4, 8, 16):
        steps, misses = [], []
        for stretch in covariates.stretches:
            count = (stretch.stop - stretch.start) // size
            if count <= NEIGHBOURS:
                continue
            part = slice(stretch.start, stretch.start + count * size)
            time = covariates.time_s[part].reshape(count, size).mean(axis=1)
            field = covariates.field_T[part].reshape(count, size, 3).mean(axis=1)
            nodes = _neighbours(slice(0, count))
            weight, _ = _weights(time[nodes] - time[:, None])
            steps.append(norm(np.diff(field, axis=0), axis=1))
            misses.append(norm(field - _combined(weight, field[nodes]), axis=1)[NEIGHBOURS // 2 : -NEIGHBOURS // 2])
        # Neighbours predict nothing of jumps, and nearly all of turns.
        if steps and np.quantile(np.concatenate(misses), 0.75) < NOTABLE * np.quantile(np.concatenate(steps), 0.75):
            return None
    return "the field changes from sample to sample in jumps, not in continuous motion"


def _neighbours(stretch: slice) -> NDArray[np.intp]:
    """Return the (n, m) indices of the m samples nearest in order to each sample of a stretch, without itself."""
    count = stretch.stop - stretch.start
    reach = min(NEIGHBOURS, count - 1)
    here = np.arange(count)[:, None]
    first = np.clip(here - reach // 2, 0, count - 1 - reach)
    nodes = first + np.arange(reach)
    return np.asarray(stretch.start + nodes + (nodes >= here))


def _weights(offset: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the weights (n, m) of value and derivative at 0 of the polynomials through nodes (n, m)."""
    difference = offset[:, :, None] - offset[:, None, :]
    same = np.eye(offset.shape[1], dtype=bool)
    difference[:, same] = 1
    ratio = -offset[:, None, :] / difference
    ratio[:, same] = 1
    value = np.prod(ratio, axis=2)
    inverse = np.broadcast_to(-1 / offset[:, None, :], ratio.shape).copy()
    inverse[:, same] = 0
    return value, value * inverse.sum(axis=2)


def _combined(weight: FloatArray, values: FloatArray) -> FloatArray:
    """Return the sums (n, 3) of values (n, m, 3) with weights (n, m)."""
    return np.asarray(np.einsum("nm,nmc->nc", weight, values))


def to_world(covariates: Covariates) -> FloatArray:
    """Return the (N, 3, 3) matrices that turn vectors of the array frame into the world's."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(covariates.channel("attitude")).as_matrix())
