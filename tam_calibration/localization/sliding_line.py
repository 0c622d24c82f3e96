"""The last stretch of a survey line, as it is recorded: bounded in time, and so in memory."""

from collections import deque

import numpy as np

from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


class SlidingLine:
    """Keeps the samples and the positions of the last seconds.

    Parameters
    ----------
    span_s : float
        Time that is kept, seconds.
    """

    def __init__(self, span_s: float) -> None:
        self._span_s = span_s
        self._samples: deque[tuple[float, FloatArray, FloatArray, FloatArray]] = deque()
        self._positions: deque[tuple[float, FloatArray]] = deque()

    def push_sample(self, time_s: float, readings_T: FloatArray, attitude: FloatArray, rates: FloatArray) -> None:
        """Add a sample; a time that steps back starts a new line.

        Parameters
        ----------
        time_s : float
            Its time, seconds.
        readings_T : (K, 3) array
            Raw readings, tesla.
        attitude : (4,) array
            Quaternion x, y, z, w from the array frame to the world; NaN where it is not known.
        rates : (3,) array
            Angular velocity in the array frame, rad/s; NaN where it is not known.
        """
        if self._samples and time_s <= self._samples[-1][0]:
            self.clear()
        self._samples.append((time_s, readings_T, attitude, rates))
        while self._samples[0][0] < time_s - self._span_s:
            self._samples.popleft()

    def push_position(self, time_s: float, position_m: FloatArray) -> None:
        """Add a position (3,) of the array's centre in the world, metres."""
        if self._positions and time_s <= self._positions[-1][0]:
            self._positions.clear()
        self._positions.append((time_s, position_m))
        while self._positions[0][0] < time_s - self._span_s:
            self._positions.popleft()

    def clear(self) -> None:
        """Forget all."""
        self._samples.clear()
        self._positions.clear()

    def recording(self) -> Recording | None:
        """Return what is kept, with positions interpolated; None where there is no line of two positions."""
        if len(self._positions) < 2 or not self._samples:
            return None
        times, readings, attitudes, rates = (np.array(part) for part in zip(*self._samples, strict=True))
        known_s, known_m = (np.array(part) for part in zip(*self._positions, strict=True))
        position = np.column_stack([np.interp(times, known_s, each, np.nan, np.nan) for each in known_m.T])
        known = rates if np.isfinite(rates).any() else None
        return Recording(times, readings, attitude=attitudes, angular_velocity_rad_s=known, position_m=position)
