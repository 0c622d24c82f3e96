"""Coverage while samples arrive, and what the turn has bought so far: how well a fit would tell the bias by now."""

from collections.abc import Sequence

import numpy as np

from tam_calibration.fit.coverage import CELLS, Coverage, judge_coverage, measure_coverage
from tam_calibration.fit.ellipsoid import sphere_center
from tam_calibration.fit.plan_turns import at_samples, expected_covariance
from tam_calibration.fit.problem import Known, Place
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


class LiveCoverage:
    """Coverage while samples arrive, from the raw readings of sensor 1 about the centre of their sphere.

    Parameters
    ----------
    capacity : int
        Samples kept; when they are full every second one is given up and only every second new one is taken.
    """

    def __init__(self, capacity: int = 4096) -> None:
        self._capacity = capacity
        self.reset()

    def reset(self) -> None:
        """Forget all samples."""
        self._kept: list[tuple[float, ...]] = []
        self._stride, self._seen, self._turned = 1, 0, 0

    def add(self, reading_T: Sequence[float], time_s: float = np.nan, has_rates: bool = False) -> None:
        """Add the raw reading (3,) of sensor 1, its stamp, and whether its angular velocity is known."""
        self._turned += has_rates
        if self._seen % self._stride == 0:
            self._kept.append((*reading_T, time_s))
            if len(self._kept) == self._capacity:
                self._kept, self._stride = self._kept[::2], 2 * self._stride
        self._seen += 1

    def summary(self) -> Coverage:
        """Return the coverage so far."""
        if len(self._kept) < 4:
            return judge_coverage(np.zeros(CELLS, dtype=int), np.zeros((CELLS, 3)))
        points = np.array(self._kept)[:, :3]
        return measure_coverage(points - sphere_center(points))

    def bought(self, array: Array) -> tuple[float, float | None]:
        """Return the largest standard error of a bias of sensor 1 so far, tesla, without and with the gyroscope.

        Infinite before the readings tell it; the second is None where no gyroscope is stated or most samples have none.
        """
        # 512 and 20: samples from which the standard error is computed, at most and at least: more change it by a
        # hundredth.
        sparse = -(-len(self._kept) // 512)
        kept = np.array(self._kept[:: max(sparse, 1)])
        is_used = array.gyroscope is not None and 2 * self._turned > self._seen
        if not is_used or len(kept) < 20 or array.vector_noise_T is None or array.scalar_noise_T is None:
            return np.inf, None
        if (np.diff(kept[:, 3]) <= 0).any():  # the clock was set
            return np.inf, None
        without, with_gyroscope = (
            float(_bias_errors(kept[:, :3], kept[:, 3], array, self._stride * sparse, has_rates).max())
            for has_rates in (False, True)
        )
        return without, with_gyroscope


def _bias_errors(points_T: FloatArray, time_s: FloatArray, array: Array, count: float, has_rates: bool) -> FloatArray:
    """Return the standard errors (3,) of the bias of sensor 1 by its readings so far, tesla; infinite where it is open.

    The scale is not known before. What the gyroscope reads about the field tells nothing, and the rest of its turn is
    that of the readings.

    Parameters
    ----------
    points_T : (N, 3) array
        Raw readings of sensor 1.
    time_s : (N,) array
        Their stamps, seconds.
    array : Array
        Whose noise is stated, and of whose gyroscope.
    count : float
        Number of samples that each represents.
    has_rates : bool
        Whether the angular velocity counts.
    """
    assert array.vector_noise_T is not None and array.scalar_noise_T is not None
    centred = points_T - sphere_center(points_T)
    lengths = np.linalg.norm(centred, axis=1, keepdims=True)
    radius_T = float(lengths.mean())
    if not (lengths > 0).all():  # sensors that are stuck
        return np.full(3, np.inf)
    along = centred / lengths
    rates = at_samples(np.cross(along[1:], along[:-1]) / np.diff(time_s)[:, None])
    scalar_T = np.full(len(along), radius_T)
    recording = Recording(time_s, radius_T * along[:, None], scalar_T, angular_velocity_rad_s=rates)
    noises_T = (each / np.sqrt(count) for each in (array.vector_noise_T[:1], array.scalar_noise_T))
    single = Array(np.zeros((1, 3)), *noises_T).with_stated_noise()
    known = Known(start=Place(SensorErrors.none(1), radius_T))
    covariance = expected_covariance(recording, single, known, array.gyroscope if has_rates else None)
    return np.sqrt(np.diag(covariance)[6:9])
