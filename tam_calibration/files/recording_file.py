"""Recordings and corrected data in whichever format, bags or CSV, and where a result came from."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

from tam_calibration.core.interpolation import without_delays
from tam_calibration.correction.calibration import Calibration, Corrected, Provenance
from tam_calibration.correction.partial import PartialCorrection
from tam_calibration.files.bag_folder import data_files
from tam_calibration.files.bag_storages import DEFAULT, STORAGES
from tam_calibration.files.csv_files import (
    read_csv_pieces,
    read_csv_recording,
    write_csv_corrected,
    write_csv_recording,
)
from tam_calibration.files.recording_stream import RecordingStream
from tam_calibration.files.text_files import in_file, printable, require_regular
from tam_calibration.messages.samples import Progress, Samples, stamps_of
from tam_calibration.messages.usage import Usage
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.extras import require
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import IntArray


def provenance(path: Path) -> Provenance:
    """Return name, size and SHA-256 of a recording; of a bag's folder those of its data files, one after the other.

    Raises
    ------
    InputError
        When the folder is no bag.
    """
    path = Path(path).resolve()
    digest, size = sha256(), 0
    for part in data_files(path):
        with part.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
                size += len(block)
    return Provenance(printable(path.name), size, digest.hexdigest())


_BAG_BEGINNINGS = tuple(storage.beginning for storage in STORAGES.values())
_BAG_SUFFIXES = tuple(storage.suffix for storage in STORAGES.values())

_LARGE_BYTES = 1 << 26

TOLERANCE_S = 0.0
"""Difference of stamps up to which readings count as of one moment; beyond it they are interpolated."""


def is_bag(path: Path) -> bool:
    """Return whether a path that exists is a bag rather than a CSV file, by its content.

    Raises
    ------
    InputError
        When there is nothing at the path, or neither a regular file nor a folder.
    """
    if not os.path.lexists(path):
        raise InputError(f"there is no file or bag {path}")
    require_regular(path)
    if path.is_dir() or path.suffix in _BAG_SUFFIXES:
        return True
    with path.open("rb") as file:
        return file.read(16).startswith(_BAG_BEGINNINGS)


def read_recording(
    path: str | Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    array: Array | None = None,
) -> Recording:
    """Read a recording from a bag or a CSV file; what a bag's topics lost in joining them is logged.

    Parameters
    ----------
    path : str or Path
        The file or folder: a bag (sqlite3 or mcap), or a CSV file with the columns time_s, b1x_nT … bKz_nT and those of
        the channels.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.

    Returns
    -------
    Recording
        In SI.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording.

    Examples
    --------
    >>> from tam_calibration import read_recording, read_scenario, simulate
    >>> simulate(read_scenario("wu_table_1")).recording.to_pandas().to_csv("run.csv")  # fields in T, as b1x_T says
    >>> recording = read_recording("run.csv", sensor_count=4)
    >>> recording.sample_count, recording.scalar_count, recording.temperature_C
    (360, 360, None)
    """
    return read_samples(Path(path), sensor_count, tolerance_s, array=array).recording


def read_samples(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
    array: Array | None = None,
    with_partial: bool = False,
) -> Samples:
    """Read a recording as `read_recording` does, with the exact stamps of a bag.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    with_partial : bool
        Whether samples of a bag are kept that lack a sensor that was silent.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording.
    """
    path = Path(path)
    if is_bag(path):
        require("bags", "reading bags")
        from tam_calibration.files.bag import read_bag

        return read_bag(path, sensor_count, round(tolerance_s * 1e9), progress, array, with_partial)
    recording = read_csv_recording(path)
    _require_sensors(path, recording, sensor_count)
    with in_file(path):
        return Samples(recording if array is None else _of_array(recording, array))


def read_pieces(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
    array: Array | None = None,
    with_partial: bool = False,
) -> Iterator[Samples]:
    """Yield a recording as `read_samples` returns it, in pieces of bounded size.

    A channel without a value in a whole piece is None in that piece.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.
    with_partial : bool
        Whether samples of a bag are kept that lack a sensor that was silent.

    Raises
    ------
    InputError
        When it cannot be read, or holds no recording; pieces before the fault have been yielded by then.
    """
    path = Path(path)
    if is_bag(path):
        require("bags", "reading bags")
        from tam_calibration.files.bag import read_bag_pieces

        yield from read_bag_pieces(path, sensor_count, round(tolerance_s * 1e9), progress, array, with_partial)
    elif array is not None and array.stamp_delay_s is not None:
        yield read_samples(path, sensor_count, tolerance_s, progress, array)
    else:
        for recording in read_csv_pieces(path):
            _require_sensors(path, recording, sensor_count)
            yield Samples(recording if array is None else _of_array(recording, array))


def _of_array(recording: Recording, array: Array) -> Recording:
    """Return what a CSV file holds in the array's axes, without the delays of its sensors."""
    turned = array.mounting.turned(recording)
    delay_s = array.stamp_delay_s
    return turned if delay_s is None else without_delays(turned, delay_s)


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
    array: Array | None = None,
) -> RecordingStream:
    """Read a recording that may be larger than memory: it is kept in temporary files as numbers.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.

    Raises
    ------
    InputError
        When it cannot be read or kept, or holds no recording.
    """
    usage: Usage | None = None

    def recordings() -> Iterator[Recording]:
        nonlocal usage
        for samples in read_pieces(path, sensor_count, tolerance_s, progress, array):
            usage = samples.usage
            yield samples.recording

    stream = RecordingStream(recordings())
    stream.usage = usage
    return stream


def read_source(
    path: Path,
    sensor_count: int | None = None,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
    array: Array | None = None,
) -> tuple[SampleSource, Usage | None]:
    """Read a recording into memory, or one that is large as `read_stream` does; return with it its usage.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    sensor_count : int, optional
        Number of sensors that there must be; by default as many as there are.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.
    array : Array, optional
        Whose delays are taken off, and into whose axes readings and attitude are turned.

    Returns
    -------
    source : SampleSource
        The samples.
    usage : Usage or None
        How many of sensor 1's messages were used; None of a CSV file.

    Raises
    ------
    InputError
        When it cannot be read or kept, or holds no recording.
    """
    source = path, sensor_count, tolerance_s, progress, array
    if is_large(path):
        stream = read_stream(*source)
        return stream, stream.usage
    samples = read_samples(*source)
    return samples.recording, samples.usage


def write_recording(path: Path, recording: Recording, storage: str = DEFAULT) -> None:
    """Write a recording: CSV for the suffix .csv, a single mcap file for .mcap, else a bag's folder.

    Parameters
    ----------
    path : Path
        Where to write.
    recording : Recording
        The samples.
    storage : str
        What a bag's folder holds: a name in ``bag_storages.STORAGES``.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_csv_recording(path, recording)
    else:
        require("bags", "writing bags")
        from tam_calibration.files.bag_writing import write_bag_recording

        write_bag_recording(path, recording, storage)


def write_corrected(
    path: Path, corrected: Corrected, stamps_ns: IntArray | None = None, source: Path | None = None
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
    pieces: Iterable[tuple[Corrected, IntArray | None]],
    source: Path | None = None,
    progress: Progress = lambda done, total: None,
) -> None:
    """Write corrected data as `write_corrected` does, piece by piece.

    Parameters
    ----------
    path : Path
        Where to write.
    pieces : iterable of (Corrected, (N,) array of int)
        Results with the stamps of the messages they came from, nanoseconds; None for the results' times.
    source : Path, optional
        The recording they came from. When it is a bag, a bag that is written carries its other topics too and has the
        same storage.
    progress : callable
        Called now and then with the bytes of a source bag that were carried over, and how many there are.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    path = Path(path)
    if path.suffix == ".csv":
        write_csv_corrected(path, (corrected for corrected, _ in pieces))
    else:
        require("bags", "writing bags")
        from tam_calibration.files.bag_corrected import write_bag_corrected

        stamped = ((each, stamps_of(each.time_s) if stamps is None else stamps) for each, stamps in pieces)
        write_bag_corrected(path, stamped, source if source and is_bag(source) else None, progress)


def correct_file(
    path: Path,
    calibration: Calibration,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
) -> Iterator[tuple[Corrected, IntArray | None]]:
    """Yield the corrected pieces of a recording with the stamps of its messages; None where it is a CSV file.

    Samples of a bag that lack a sensor that was silent are corrected with the others.

    Parameters
    ----------
    path : Path
        The bag or CSV file.
    calibration : Calibration
        What to correct with; where it holds effects, the whole recording is one piece.
    tolerance_s : float
        Greatest difference of stamps within a sample of a bag, seconds.
    progress : callable
        Called now and then with the bytes read of a bag, and how many there are; not of a CSV file.

    Raises
    ------
    InputError
        When it cannot be read, and at the end when it is mostly not in tesla.
    """
    source = path, calibration.errors.sensor_count, tolerance_s, progress, calibration.array, True
    partial = PartialCorrection(calibration)
    # Effects reach from one piece into the next, and holes in their channels are filled from both sides.
    pieces = [read_samples(*source)] if calibration.effects else read_pieces(*source)
    wrong_units: list[InputError] = []
    right_units = 0
    for samples in pieces:
        if samples.missing is not None:
            corrected = partial.correct(samples.recording, samples.missing)
        elif calibration.effects:
            corrected = calibration.correct(samples.recording)
        else:
            outputs = calibration.apply(samples.recording.readings_T)
            corrected = Corrected(samples.recording.time_s, outputs, calibration.output_standard_errors)
        whole = calibration.without_effects(samples.recording) if calibration.effects else samples.recording
        try:
            samples.recording.check_units(calibration.array.field)
            right_units += 1
        except InputError as problem:
            wrong_units.append(problem)
        yield replace(corrected, scalar_T=whole.scalar_T), samples.stamps_ns
    if len(wrong_units) > right_units:
        raise wrong_units[0]
