"""Poses of an array, and the amplitudes of an alternating source in those in which it stood still."""

from dataclasses import dataclass

import numpy as np

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.sources.demodulation import Stretch, demodulate


@dataclass(frozen=True, eq=False)
class Poses:
    """Where the array was, N times.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w that turn vectors of the array frame into the world's.
    position_m : (N, 3) array
        Of the array's centre in the world, metres.
    """

    attitude: FloatArray
    position_m: FloatArray

    @classmethod
    def headings(cls, attitude: FloatArray) -> "Poses":
        """Return the poses of an array that was turned about its centre, which is the origin of the world."""
        return cls(attitude, np.zeros((len(attitude), 3)))

    @property
    def matrix(self) -> FloatArray:
        """(N, 3, 3) rotations from the array frame to the world."""
        return matrices_of(self.attitude)


_STILL = from_degrees(0.2)
"""An attitude that stays within this angle of its first is one pose, radians."""
FEWEST_PERIODS = 10.0
"""A pose lasts at least so many periods of the source."""


@dataclass(frozen=True, eq=False)
class PoseAmplitudes:
    """What the sensors read of a source in N poses.

    Parameters
    ----------
    poses : Poses
        Of the array, its centre at the origin of the world.
    amplitudes_T : (N, K, 3) array
        Raw, tesla; of each pose the sign of all together is open.
    noise_T : (N, K, 3) array
        Their standard errors.
    """

    poses: Poses
    amplitudes_T: FloatArray
    noise_T: FloatArray


def amplitudes_of(recording: Recording, frequency_hz: float) -> PoseAmplitudes:
    """Return the amplitudes of a source in each pose of a recording.

    Parameters
    ----------
    recording : Recording
        Of an array that was turned and stood still in turn, with attitude.
    frequency_hz : float
        Of the source.

    Raises
    ------
    InputError
        When there is no attitude, or no pose lasts long enough.
    """
    if recording.attitude is None:
        raise InputError("the recording of the source has no attitude: without it the poses are not known")
    recording = recording.take(np.flatnonzero(np.isfinite(recording.attitude).all(axis=1)))
    assert recording.attitude is not None
    stretches = poses_of(recording, frequency_hz)
    if not stretches:
        raise InputError(
            f"the array stood still nowhere for {FEWEST_PERIODS / frequency_hz:g} s, {FEWEST_PERIODS:g} periods of the "
            f"source at {frequency_hz:g} Hz: let it rest in each heading"
        )
    middles = [(part.start + part.stop) // 2 for part in stretches]
    found = [demodulate(Stretch.of(recording.take(part)), frequency_hz) for part in stretches]
    amplitudes, noise = (
        np.array(values).reshape(len(found), -1, 3)
        for values in ([each.amplitude for each in found], [each.standard_errors for each in found])
    )
    return PoseAmplitudes(Poses.headings(recording.attitude[middles]), amplitudes, noise)


def poses_of(recording: Recording, frequency_hz: float) -> list[slice]:
    """Return the stretches of a recording, its attitude known throughout, in which the array stood still.

    Parameters
    ----------
    recording : Recording
        Its attitude known in every sample.
    frequency_hz : float
        Of the source: a stretch lasts at least ``FEWEST_PERIODS`` of its periods.
    """
    assert recording.attitude is not None
    shortest = FEWEST_PERIODS / frequency_hz
    return [part for part in _still(recording.attitude) if np.ptp(recording.time_s[part]) >= shortest]


def _still(attitude: FloatArray) -> list[slice]:
    """Return the stretches in which the attitude (N, 4) stays where it is at the first sample."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    stretches, start = [], 0
    while start < len(unit):
        moved = np.abs(unit[start:] @ unit[start]) < np.cos(_STILL / 2)
        length = int(moved.argmax()) if moved.any() else len(moved)
        stretches.append(slice(start, start + length))
        start += length
    return stretches
