"""Recordings and corrected data in whichever format: bags (folders, .mcap, .db3) or CSV."""

from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tam_calibration.calibration import Corrected
from tam_calibration.exceptions import InputError
from tam_calibration.files.csv_corrected import write_csv_corrected
from tam_calibration.files.csv_recording import read_csv_pieces, read_csv_recording, write_csv_recording
from tam_calibration.files.recording_stream import RecordingStream
from tam_calibration.files.samples import Progress, Samples, stamps_of
from tam_calibration.recording import Recording

_BAG_BEGINNINGS = (b"\x89MCAP0\r\n", b"SQLite format 3\0")
_BAG_SUFFIXES = (".mcap", ".db3")

_LARGE_BYTES = 1 << 26

TOLERANCE_S = 1e-3


def is_bag(path: Path) -> bool:
    """Return whether a path that exists is a bag rather than a CSV file, by its content.

    Raises
    ------
    InputError
        When there is nothing at the path.
    """
    if not path.exists():
        raise InputError(f"there is no file or bag {path}")
    if path.is_dir() or path.suffix in _BAG_SUFFIXES:
        return True
    with path.open("rb") as file:
        return file.read(16).startswith(_BAG_BEGINNINGS)


def read_recording(path: str | Path, sensor_count: int | None = None, tolerance_s: float = TOLERANCE_S) -> Recording:
    """Read a recording from a bag or a CSV file; what a bag's topics lost in joining them is logged.

    Parameters
    ----------
    path : Path
        The file or folder.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording.
    """
    return read_samples(Path(path), sensor_count, tolerance_s).recording


def read_samples(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
) -> Samples:
    """Read a recording as `read_recording` does, with the exact stamps of a bag, and tell the progress.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording.
    """
    path = Path(path)
    if is_bag(path):
        from tam_calibration.files.bag import read_bag  # late: a CSV file does not need rosbags

        return read_bag(path, sensor_count, round(tolerance_s * 1e9), progress)
    recording = read_csv_recording(path)
    _require_sensors(path, recording, sensor_count)
    return Samples(recording)


def read_pieces(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
) -> Iterator[Samples]:
    """Yield a recording as `read_samples` returns it, in pieces of bounded size.

    A channel without a value in a whole piece is None in that piece.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording; pieces before the fault have been yielded by then.
    """
    path = Path(path)
    if is_bag(path):
        from tam_calibration.files.bag import read_bag_pieces  # late: a CSV file does not need rosbags

        yield from read_bag_pieces(path, sensor_count, round(tolerance_s * 1e9), progress)
    else:
        for recording in read_csv_pieces(path):
            _require_sensors(path, recording, sensor_count)
            yield Samples(recording)


def _require_sensors(path: Path, recording: Recording, sensor_count: int | None) -> None:
    if sensor_count not in (None, recording.sensor_count):
        raise InputError(f"{path}: the recording has {recording.sensor_count} sensors, not {sensor_count}")


def is_large(path: Path) -> bool:
    """Return whether a file, or the files of a folder, had better be read in pieces: from 64 MiB on."""
    parts = path.iterdir() if path.is_dir() else [path]
    return sum(part.stat().st_size for part in parts if part.is_file()) >= _LARGE_BYTES


def read_stream(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
) -> RecordingStream:
    """Read a recording that may be larger than memory: it is kept in temporary files as numbers.

    Raises
    ------
    InputError
        When it cannot be read or kept, or holds no recording.
    """
    return RecordingStream(samples.recording for samples in read_pieces(path, sensor_count, tolerance_s, progress))


def write_recording(path: Path, recording: Recording, storage: str = "sqlite3") -> None:
    """Write a recording: CSV for the suffix .csv, a single mcap file for .mcap, else a bag's folder.

    Parameters
    ----------
    path : Path
        Where to write.
    recording : Recording
        The samples.
    storage : str
        What a bag's folder holds: ``sqlite3`` or ``mcap``.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_csv_recording(path, recording)
    else:
        from tam_calibration.files.bag_writing import write_bag_recording  # late: a CSV file does not need rosbags

        write_bag_recording(path, recording, storage)


def write_corrected(
    path: Path, corrected: Corrected, stamps_ns: NDArray[np.int64] | None = None, source: Path | None = None
) -> None:
    """Write corrected data: CSV for the suffix .csv, a single mcap file for .mcap, else a bag's folder.

    Parameters
    ----------
    path : Path
        Where to write.
    corrected : Corrected
        The results.
    stamps_ns : (N,) array of int, optional
        Stamps of the messages of a bag; by default the results' times.
    source : Path, optional
        The recording they came from. When it is a bag, a bag that is written carries its other topics too and
        has the same storage.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    write_corrected_pieces(path, [(corrected, stamps_ns)], source)


def write_corrected_pieces(
    path: Path,
    pieces: Iterable[tuple[Corrected, NDArray[np.int64] | None]],
    source: Path | None = None,
    progress: Progress = lambda done, total: None,
) -> None:
    """Write corrected data as `write_corrected` does, from results and stamps that come piece by piece.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_csv_corrected(path, (corrected for corrected, _ in pieces))
    else:
        from tam_calibration.files.bag_corrected import write_bag_corrected  # late: a CSV file does not need rosbags

        stamped = ((each, stamps_of(each.time_s) if stamps is None else stamps) for each, stamps in pieces)
        write_bag_corrected(path, stamped, source if source and is_bag(source) else None, progress)
