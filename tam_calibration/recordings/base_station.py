"""The intensity that a base station records, in place of a scalar magnetometer on the array."""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np

from tam_calibration.messages.samples import Samples
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.iaga2002 import read_intensity

_LONGEST_GAP_S = 180.0
"""Between values of the station that are interpolated: the field's pulsations and storms take minutes."""


def with_base_station(samples: Samples, path: Path | None) -> Samples:
    """Return samples whose intensity is the station's where they have none of their own.

    Beside a scalar magnetometer the station's values are shifted by the median of what the two differ.

    Parameters
    ----------
    samples : Samples
        Their times are seconds since 1970.
    path : Path, optional
        IAGA-2002 file of the station; without one the samples stay as they are.

    Raises
    ------
    InputError
        When the station has no value at the time of the recording.
    """
    if path is None:
        return samples
    recording = samples.recording
    station_T = _at(path, recording.time_s)
    own_T = recording.scalar_T
    if own_T is not None:
        both = np.isfinite(own_T) & np.isfinite(station_T)
        shift_T = float(np.median(own_T[both] - station_T[both])) if both.any() else 0.0
        station_T = np.where(np.isnan(own_T), station_T + shift_T, own_T)
    return replace(samples, recording=replace(recording, scalar_T=station_T))


@lru_cache(maxsize=2)
def _record(path: Path) -> tuple[FloatArray, FloatArray]:
    return read_intensity(path)


def _at(path: Path, time_s: FloatArray) -> FloatArray:
    """Return the station's intensity (N,) at some times, NaN within its gaps.

    Raises
    ------
    InputError
        When it has none.
    """
    own_s, own_T = _record(path)
    after = np.clip(np.searchsorted(own_s, time_s), 1, len(own_s) - 1)
    is_near = (own_s[after] - own_s[after - 1] <= _LONGEST_GAP_S) & (time_s >= own_s[0]) & (time_s <= own_s[-1])
    if not is_near.any():
        first, last = (np.datetime64(int(each), "s") for each in (own_s[0], own_s[-1]))
        own = np.datetime64(int(time_s[0]), "s")
        raise InputError(
            f"the base station has values from {first} to {last} UTC, and the recording begins at {own}: its times "
            "must be times of day, and within those of the station"
        )
    return np.where(is_near, np.interp(time_s, own_s, own_T), np.nan)
