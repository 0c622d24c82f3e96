"""Some samples of a recording, for checks that do not depend on their order."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.model.recording import SKETCH, Recording, SampleSource
from tam_calibration.model.units import FloatArray

SHARED = 0.9
"""Least canonical correlation of sensors that both show the motion in all directions, and not their noise."""

LARGEST_T = 1e9
"""Tesla: the Earth's field in nT, taken for T, has some 1e4; squares of larger numbers are none."""


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
        return np.clip(values, -LARGEST_T, LARGEST_T, out=values)

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
