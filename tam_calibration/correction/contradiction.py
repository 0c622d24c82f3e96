"""Finds sensors that fail while a survey goes on: their corrected readings contradict those of all others."""

from collections import Counter
from collections.abc import Iterator

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.model.exceptions import TIMES, first_at
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import IntArray

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
    """Finds the failing sensors of the pieces of a recording, in the order of time, and counts them.

    Parameters
    ----------
    calibration : Calibration
        Of the sensors.
    """

    def __init__(self, calibration: Calibration) -> None:
        self._unmix, self._bias_T = np.linalg.inv(calibration.errors.matrix), calibration.errors.bias_T
        self._count, self._begin_s = 0, 0.0
        self._wrong, self._first_s = Counter[int](), dict[int, list[float]]()

    def codes_of(self, recording: Recording) -> IntArray:
        """Return which sensors fail in each sample (N,), as ``partial.missing_codes`` does.

        Parameters
        ----------
        recording : Recording
            Raw readings, missing ones filled.
        """
        codes = np.zeros(recording.sample_count, dtype=np.int64)
        self._begin_s = self._begin_s if self._count else float(recording.time_s[0])
        self._count += len(codes)
        sensor_count = recording.sensor_count
        fields_T = np.einsum("kij,nkj->nki", self._unmix, recording.readings_T - self._bias_T)
        for sensor in range(sensor_count) if sensor_count >= _FEWEST else ():
            others_T = np.delete(fields_T, sensor, axis=1)
            center_T = others_T.mean(axis=1)
            spread_T = np.linalg.norm(others_T - center_T[:, None], axis=2).max(axis=1)
            least_T = np.maximum(_APART * np.linalg.norm(center_T, axis=1), _OVER_OTHERS * spread_T)
            is_wrong = np.linalg.norm(fields_T[:, sensor] - center_T, axis=1) > least_T
            codes[is_wrong] |= 1 << sensor
            self._wrong[sensor] += int(is_wrong.sum())
            self._first_s.setdefault(sensor, []).extend((recording.time_s[is_wrong][:TIMES] - self._begin_s).tolist())
        return codes

    def sentences(self) -> Iterator[str]:
        """Yield one sentence for each sensor that has failed until now."""
        for sensor, wrong in sorted((+self._wrong).items()):
            yield left_out(wrong, self._count, f"sensor {sensor + 1}", first_at(self._first_s[sensor]))
