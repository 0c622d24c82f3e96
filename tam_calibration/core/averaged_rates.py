"""Angular velocities that come quicker than samples: their mean since the sample before, not the newest alone.

Of the newest alone, noise and vibration between the samples would count as if they lasted until the next. A mean of M
values over the time T is less than an angular velocity in its middle by (1 - 1/M²) T²/24 of its second derivative: that
of the means before it is taken off, as a swing that reads a thousandth too small is a bias of the field.
"""

import numpy as np

from tam_calibration.model.units import FloatArray, IntArray


class AveragedRates:
    """The angular velocities since the last sample."""

    def __init__(self) -> None:
        self._stamps_ns, self._rates = np.empty(0, dtype=np.int64), np.empty((0, 3))
        self._last_ns: int | None = None
        self._is_even = True
        self._before = np.full((2, 3), np.nan)

    def add(self, stamps_ns: IntArray | None, rates: FloatArray) -> None:
        """Take messages: their stamps (n,) and angular velocities (n, 3)."""
        if stamps_ns is None:
            self._is_even = False
            return
        known = np.isfinite(rates).all(axis=1)
        # Angular velocities that wait for a sample at most.
        most = 65_536
        self._stamps_ns = np.concatenate([self._stamps_ns, stamps_ns[known]])[-most:]
        self._rates = np.concatenate([self._rates, rates[known]])[-most:]

    def means(self, stamps_ns: IntArray, newest: FloatArray) -> FloatArray:
        """Return the angular velocities (n, 3) of samples, the newest ones where there are not several for one.

        Parameters
        ----------
        stamps_ns : (n,) array of int
            Of samples that follow each other.
        newest : (n, 3) array
            What joined them; NaN where nothing did.
        """
        edges = stamps_ns if self._last_ns is None else np.append(self._last_ns, stamps_ns)
        intervals = np.diff(edges)
        self._is_even &= bool((np.diff(self._stamps_ns) > 0).all()) and bool((intervals > 0).all())
        if not self._is_even or not len(intervals):
            self._last_ns = int(stamps_ns[-1])
            return newest
        usual_ns = int(np.median(intervals))
        before = stamps_ns[0] - usual_ns if self._last_ns is None else self._last_ns
        # Intervals of samples over which angular velocities are averaged at most: longer ones are gaps.
        begins = np.maximum(np.append(before, stamps_ns[:-1]), stamps_ns - int(1.5 * usual_ns))
        first, last = (np.searchsorted(self._stamps_ns, each, side="right") for each in (begins, stamps_ns))
        sums = np.vstack([np.zeros(3), np.cumsum(self._rates, axis=0)])
        count = np.maximum(last - first, 1)[:, None]
        means = np.where((count > 1) & np.isfinite(newest), (sums[last] - sums[first]) / count, newest)
        course = np.vstack([self._before, means])
        bend = (1 - 1 / count**2) / 24 * np.diff(course, 2, axis=0)
        self._last_ns, self._before = int(stamps_ns[-1]), course[-2:]
        self._stamps_ns, self._rates = self._stamps_ns[last[-1] :], self._rates[last[-1] :]
        return np.where(np.isfinite(bend), means - bend, means)
