"""Finds sensors that fail while a survey goes on: their corrected readings contradict those of all others."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.exceptions import TIMES, first_at
from tam_calibration.model.units import FloatArray, IntArray

_FEWEST = 3
"""Sensors of which the others outvote one."""

_APART = 0.1
"""Smallest deviation of a failing sensor, as a part of the field: a dipole of 150 A m² makes 2 % of 50 µT at 3 m."""

_OVER_OTHERS = 20.0
"""That deviation over the largest of the others: a dipole 0.6 m from the centre of a 0.5 m cross makes at most 17."""


def left_out(count: int, total: int, whose: str, when: str) -> str:
    """Return how many readings were left out because they contradict the others, and when they were made."""
    verbs = "contradicts the others and is" if count == 1 else "contradict the others and are"
    return f"{count} of {total} readings of {whose} {verbs} left out, {when}"


class ContradictionSearch:
    """Finds the failing sensors of samples, in the order of time, and counts them.

    Parameters
    ----------
    calibration : Calibration
        Of the sensors.
    """

    def __init__(self, calibration: Calibration) -> None:
        errors, count = calibration.errors, calibration.errors.sensor_count
        self._unmix, self._bias_T, self._sensor_count = np.linalg.inv(errors.matrix), errors.bias_T, count
        weights = np.vstack([np.eye(count) - 1 / count, np.full(count, 1 / count)])  # of deviations, and of the mean
        self._deviations = np.einsum("ik,kab->kbia", weights, self._unmix).reshape(3 * count, -1)
        self._least_part2 = (_APART * (1 - 1 / count) / (1 + _APART / count)) ** 2
        self._count, self._begin_s = 0, 0.0
        self._wrong, self._first_s = Counter[int](), dict[int, list[float]]()

    def codes_of(self, time_s: FloatArray, readings_T: FloatArray) -> IntArray:
        """Return which sensors fail in each sample (N,), as ``partial.missing_codes`` does.

        Parameters
        ----------
        time_s : (N,) array
            Time stamps of the samples, seconds.
        readings_T : (N, K, 3) array
            Raw readings, missing ones filled, tesla.
        """
        codes = np.zeros(len(time_s), dtype=np.int64)
        self._begin_s = self._begin_s if self._count else float(time_s[0])
        self._count += len(codes)
        if self._sensor_count >= _FEWEST and (suspected := np.flatnonzero(self._may_fail(readings_T))).size:
            codes[suspected] = self._failing(time_s[suspected], readings_T[suspected])
        return codes

    def _may_fail(self, readings_T: FloatArray) -> np.ndarray:
        """Return where a sensor may deviate by the least part of the field from the mean of the others.

        From the mean of all it then deviates by (K - 1) / K of that. Samples of sound sensors are spared the rest.
        """
        parts = (readings_T - self._bias_T).reshape(len(readings_T), -1) @ self._deviations
        squares = np.square(parts).reshape(len(parts), -1, 3).sum(axis=2)
        return np.asarray(~(squares[:, :-1].max(axis=1) < self._least_part2 * squares[:, -1]))

    def _failing(self, time_s: FloatArray, readings_T: FloatArray) -> IntArray:
        """Return the codes of samples, and count those of each sensor."""
        codes = np.zeros(len(time_s), dtype=np.int64)
        fields_T = np.einsum("kij,nkj->nki", self._unmix, readings_T - self._bias_T)
        for sensor in range(self._sensor_count):
            others_T = np.delete(fields_T, sensor, axis=1)
            center_T = others_T.mean(axis=1)
            spread_T = np.linalg.norm(others_T - center_T[:, None], axis=2).max(axis=1)
            least_T = np.maximum(_APART * np.linalg.norm(center_T, axis=1), _OVER_OTHERS * spread_T)
            is_wrong = np.linalg.norm(fields_T[:, sensor] - center_T, axis=1) > least_T
            codes[is_wrong] |= 1 << sensor
            self._wrong[sensor] += int(is_wrong.sum())
            first_s = self._first_s.setdefault(sensor, [])
            first_s += (time_s[is_wrong][: TIMES - len(first_s)] - self._begin_s).tolist()
        return codes

    def sentences(self) -> Iterator[str]:
        """Yield one sentence for each sensor that has failed until now."""
        for sensor, wrong in sorted((+self._wrong).items()):
            yield left_out(wrong, self._count, f"sensor {sensor + 1}", first_at(self._first_s[sensor]))
