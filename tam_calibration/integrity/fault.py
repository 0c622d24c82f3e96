"""A fault of a channel, which faults a person may accept, and the samples of a recording in which faults are sought."""

from collections.abc import Collection, Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np

from tam_calibration.correction.acceptance import LIMITS
from tam_calibration.model.exceptions import MOST_NAMED, InputError, Refused
from tam_calibration.model.limits import LARGEST
from tam_calibration.model.recording import SKETCH, Recording, SampleSource
from tam_calibration.model.units import FloatArray, origin_of, to_nanotesla

CHANNEL_FAULTS = {
    "alternating": "a sensor that reads two courses in turn, as where two publishers send on its topic",
    "few_samples": "fewer samples than leave enough to check a fit on",
    "frozen": "a sensor or axis that stays at one value while the others move",
    "mirrored": "a sensor whose axes are left-handed, or two of which are exchanged",
    "quantised": "steps of the readings far above the stated noise",
    "repeated": "a sensor or axis that repeats another, at once or later",
    "saturated": "an axis that stays at an end of its range",
    "scalar": "a scalar that follows the direction of the field, as near a magnet",
    "stuck_bits": "an axis of whose values one bit never changes",
    "unit": "an axis, a sensor or the scalar in another unit than the others",
    "zero": "readings that are exactly zero",
}
"""Names of the faults of channels, for messages and `--accept`, and what each is."""

ACCEPTABLE = {**CHANNEL_FAULTS, "accuracy": "noise that leaves parameters open", **LIMITS}
"""The names of all that may be accepted: of the channels, and of the calibration that was fitted."""

Severity = Literal["refusal", "warning", "note"]


@dataclass(frozen=True)
class Fault:
    """Something in the channels that no sound sensor reads.

    Parameters
    ----------
    name : str
        One of ``CHANNEL_FAULTS``.
    sensor : int or None
        From 1; None if it is the scalar, or unknown.
    axis : str
        x, y or z; empty for all axes of the sensor.
    time_s : tuple of float
        First and last time, seconds.
    sentence : str
        What it is, where and when, for people.
    severity : str
        Whether the numbers of a fit would be wrong ("refusal"), hardly ("warning"), or not ("note").
    may_be_effect : bool
        Whether an effect can make it, which a diagnosis then finds: not a sensor that is frozen throughout.
    is_acceptable : bool
        Whether a calibration is possible in spite of it.
    """

    name: str
    sensor: int | None
    axis: str
    time_s: tuple[float, float]
    sentence: str
    severity: Severity = "refusal"
    may_be_effect: bool = False
    is_acceptable: bool = True


def fault_of_axis(
    name: str,
    row: int,
    words: str,
    time_s: tuple[float, float],
    severity: Severity = "refusal",
    may_be_effect: bool = False,
) -> Fault:
    """Return a fault of one axis; its sentence is the axis and the words.

    Parameters
    ----------
    name : str
        As of ``Fault``.
    row : int
        3 i + a for axis a of sensor i, both from 0.
    words : str
        What the axis does.
    time_s, severity, may_be_effect
        As of ``Fault``.
    """
    sensor, axis = row // 3 + 1, "xyz"[row % 3]
    return Fault(name, sensor, axis, time_s, f"{channel(sensor, axis)} {words}", severity, may_be_effect)


def channel(sensor: int, axis: str = "") -> str:
    """Return a sensor, numbered from 1, or one of its axes for people."""
    return f"sensor {sensor} axis {axis}" if axis else f"sensor {sensor}"


def between(time_s: tuple[float, float], whole_s: tuple[float, float]) -> str:
    """Return a part of a recording's span of time for people."""
    if time_s == whole_s:
        return "throughout"
    first_s, last_s = (one - origin_of(whole_s[0]) for one in time_s)
    return f"between {first_s:.2f} and {last_s:.2f} s"


def in_nanotesla(tesla: float) -> str:
    """Return a field for people."""
    return f"{to_nanotesla(tesla):.6g} nT"


def names_in(text: str) -> list[str]:
    """Return the names in a text that separates them by commas."""
    return [name.strip() for name in text.split(",") if name.strip()]


def require_names(accept: Collection[str]) -> None:
    """Check that all names are those of faults.

    Raises
    ------
    InputError
        When one is not.
    """
    for name in accept:
        if name not in ACCEPTABLE:
            raise InputError(f"there is no finding {name!r} to accept: choose among {', '.join(ACCEPTABLE)}")


def refuse(faults: Iterable[Fault]) -> None:
    """Refuse a recording for its faults, if any.

    Raises
    ------
    Refused
        The message states them, and the names to accept them by.
    """
    found = list(faults)
    if not found:
        return
    more = f"; and {len(found) - MOST_NAMED} more such findings" if len(found) > MOST_NAMED else ""
    sentences = "; ".join(fault.sentence for fault in found[:MOST_NAMED])
    names = ", ".join(dict.fromkeys(fault.name for fault in found))
    advice = f", or accept it by name: {names}" if all(fault.is_acceptable for fault in found) else ""
    raise Refused(f"{sentences}{more}; correct that{advice}")


SHARED = 0.9
"""Least canonical correlation of sensors that both show the motion in all directions, and not their noise."""


@dataclass(frozen=True, eq=False)
class Overview:
    """Some samples (n, K, 3) of a recording of K sensors, in the order of time."""

    recording: Recording
    time_s: tuple[float, float]

    @classmethod
    def of(cls, source: SampleSource) -> "Overview":
        """Return that of a complete recording of any size."""
        # Samples at most: a share of one per cent of them is 20 samples, which no chance makes of a sound axis.
        return cls(source.thinned(SKETCH).thinned(2000), source.time_span_s)

    @property
    def sensor_count(self) -> int:
        """Number of sensors K."""
        return self.recording.sensor_count

    @cached_property
    def values_T(self) -> FloatArray:
        """(3K, n) readings of all axes, in the order of time, those that are no field at all moved to the largest."""
        values = np.ascontiguousarray(self.recording.readings_T.reshape(self.recording.sample_count, -1).T)
        largest_T = LARGEST["readings"]
        return np.clip(values, -largest_T, largest_T, out=values)

    @cached_property
    def sorted_T(self) -> FloatArray:
        """(3K, n) readings of each axis, in increasing order."""
        return np.sort(self.values_T, axis=1)

    @cached_property
    def without_spikes_T(self) -> FloatArray:
        """(3K, n) readings about their mean, those beyond all but one per cent moved to there."""
        count = self.sorted_T.shape[1]
        # Share of the samples at either end that may be spikes, and do not count for the spread of an axis.
        lone = int(0.01 * count)
        low, high = self.sorted_T[:, lone : lone + 1], self.sorted_T[:, count - 1 - lone : count - lone]
        clipped = np.clip(self.values_T, low, high)
        return np.asarray(clipped - clipped.mean(axis=1, keepdims=True))

    @cached_property
    def covariance(self) -> FloatArray:
        """(K, K, 3, 3) covariances of the sensors, without spikes, T²."""
        values, count = self.without_spikes_T, self.sensor_count
        return np.asarray((values @ values.T / values.shape[1]).reshape(count, 3, count, 3).swapaxes(1, 2))

    def shared_motion(self, one: int, other: int) -> float:
        """Return the smallest canonical correlation of two sensors: 1 where the same motion is all that both read."""
        roots = []
        for sensor in (one, other):
            values, vectors = np.linalg.eigh(self.covariance[sensor, sensor])
            if not values[0] > 0:
                return 0.0
            roots.append(vectors / np.sqrt(values))
        shared = roots[0].T @ self.covariance[one, other] @ roots[1]
        return float(np.linalg.svd(shared, compute_uv=False)[-1])

    @cached_property
    def spread_T(self) -> FloatArray:
        """(K, 3) standard deviations of the axes, without spikes."""
        own = self.covariance[range(self.sensor_count), range(self.sensor_count)]
        return np.sqrt(np.diagonal(own, axis1=1, axis2=2))

    @cached_property
    def principal_T(self) -> FloatArray:
        """(K, 3) standard deviations of each sensor's readings along their principal directions, increasing."""
        own = self.covariance[range(self.sensor_count), range(self.sensor_count)]
        return np.asarray(np.sqrt(np.maximum(np.linalg.eigvalsh(own), 0)))
