"""Observatory files in the IAGA-2002 format, and the intensity that such a base station gives a recording."""

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from pathlib import Path

import numpy as np

from tam_calibration.files.text_files import in_file, read_text
from tam_calibration.messages.samples import Samples
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla


@dataclass(frozen=True, eq=False)
class ObservatoryRecord:
    """The field at an observatory.

    Parameters
    ----------
    start : datetime
        Of the first row, UTC.
    time_s : (M,) array
        Seconds from the start, increasing.
    field_T : (M, 3) array
        Components to magnetic north, magnetic east and down, tesla; NaN where a value is missing.
    """

    start: datetime
    time_s: FloatArray
    field_T: FloatArray


def read_iaga2002(path: Path) -> ObservatoryRecord:
    """Return the record of an IAGA-2002 file that reports H E Z, H D Z or X Y Z.

    Raises
    ------
    InputError
        When the file cannot be read, is of another format, reports other components, or contains a broken row.
    """
    with in_file(path):
        start, time_s, columns = _columns(read_text(path).splitlines())
        return ObservatoryRecord(start, time_s, _meridian_components(columns))


@lru_cache(maxsize=2)
def read_intensity(path: Path) -> tuple[FloatArray, FloatArray]:
    """Return the times (M,), seconds since 1970, and intensities (M,), tesla, of an IAGA-2002 file.

    The intensity is F, or S of a scalar magnetometer, where it is reported, else the length of the vector.

    Raises
    ------
    InputError
        As of `read_iaga2002`, and when no intensity is known.
    """
    with in_file(path):
        start, time_s, columns = _columns(read_text(path).splitlines())
        reported = [from_nanotesla(columns[letter]) for letter in "FS" if letter in columns]
        intensity_T = reported[0] if reported else np.linalg.norm(_meridian_components(columns), axis=1)
        known = np.isfinite(intensity_T)
        if known.sum() < 2:
            raise InputError("it has no intensity: F, S or three components are needed")
        return (start.replace(tzinfo=UTC).timestamp() + time_s)[known], intensity_T[known]


def _columns(lines: list[str]) -> tuple[datetime, FloatArray, dict[str, FloatArray]]:
    """Return the first time, the times after it in seconds, and the values by the letter of their component."""
    if "IAGA-2002" not in lines[0].upper():
        raise InputError("this is not an IAGA-2002 file: its first line must name the format")
    first = next((number for number, line in enumerate(lines) if line.startswith("DATE")), None)
    if first is None:
        raise InputError("the line DATE TIME DOY … that names the columns is missing")
    letters = [column[-1] for column in lines[first].rstrip("| ").split()[3:]]
    body = [(number, line) for number, line in enumerate(lines[first + 1 :], first + 2) if line.strip()]
    rows = [_read_row(number, line, len(letters)) for number, line in body]
    if not rows:
        raise InputError("the file has no values")
    stamps = np.array([stamp for stamp, _ in rows], dtype="datetime64[ms]")
    values = np.array([row for _, row in rows])
    # 88888 stands for "not reported", 99999 for "missing".
    values[~(np.abs(values) < 88_888.0)] = np.nan
    time_s = (stamps - stamps[0]) / np.timedelta64(1, "s")
    if not (np.diff(time_s) > 0).all():
        raise InputError("time repeats or goes backwards: give one file as the observatory publishes it")
    return rows[0][0], time_s, dict(zip(letters, values.T, strict=True))


def _read_row(number: int, line: str, count: int) -> tuple[datetime, list[float]]:
    """Return the time and the values of one row."""
    try:
        day, time, _, *values = line.split()
        if len(values) != count:
            raise ValueError
        return datetime.fromisoformat(f"{day}T{time}"), [float(value) for value in values]
    except ValueError:
        raise InputError(f"line {number} does not hold date, time, day of year and {count} values") from None


def _meridian_components(columns: dict[str, FloatArray]) -> FloatArray:
    """Return the (M, 3) components to magnetic north, magnetic east and down, tesla."""
    if {"H", "E", "Z"} <= columns.keys():
        north, east = columns["H"], columns["E"]
    elif {"H", "D", "Z"} <= columns.keys():
        declination = from_degrees(columns["D"] / 60)  # reported in minutes of arc
        north, east = _turn_to_mean(columns["H"] * np.cos(declination), columns["H"] * np.sin(declination))
    elif {"X", "Y", "Z"} <= columns.keys():
        north, east = _turn_to_mean(columns["X"], columns["Y"])
    else:
        raise InputError(f"the components are {' '.join(columns)}; H E Z, H D Z or X Y Z are needed")
    return from_nanotesla(np.stack([north, east, columns["Z"]], axis=1))


def _turn_to_mean(north: FloatArray, east: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return geographic components along and across their own mean direction."""
    if not np.isfinite(north + east).any():
        raise InputError("no row has both horizontal components: take another day of the observatory")
    meridian = np.arctan2(np.nanmean(east), np.nanmean(north))
    cosine, sine = np.cos(meridian), np.sin(meridian)
    return north * cosine + east * sine, east * cosine - north * sine


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


def _at(path: Path, time_s: FloatArray) -> FloatArray:
    """Return the station's intensity (N,) at some times, NaN within its gaps.

    Raises
    ------
    InputError
        When it has none.
    """
    own_s, own_T = read_intensity(path)
    after = np.clip(np.searchsorted(own_s, time_s), 1, len(own_s) - 1)
    # Longer gaps are not interpolated: pulsations and storms of the field take minutes.
    is_near = (own_s[after] - own_s[after - 1] <= 180.0) & (time_s >= own_s[0]) & (time_s <= own_s[-1])
    if not is_near.any():
        first, last = (np.datetime64(int(each), "s") for each in (own_s[0], own_s[-1]))
        own = np.datetime64(int(time_s[0]), "s")
        raise InputError(
            f"the base station has values from {first} to {last} UTC, and the recording begins at {own}: its times "
            "must be times of day, and within those of the station"
        )
    return np.where(is_near, np.interp(time_s, own_s, own_T), np.nan)
