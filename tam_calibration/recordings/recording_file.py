"""Recordings of any format read into samples, complete or in pieces, and where a result came from."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from hashlib import file_digest, sha256
from importlib.metadata import entry_points
from os import path as paths
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tam_calibration.correction.parts import Provenance
from tam_calibration.files.text_files import in_file, require_regular
from tam_calibration.messages.missing import in_words
from tam_calibration.messages.samples import Progress, Samples
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, printable
from tam_calibration.model.recording import Recording
from tam_calibration.recordings.bag_storages import data_files, is_bag
from tam_calibration.recordings.channel_map import AS_IT_IS, ChannelMap, Pick, Reading, TimeColumn, Window, as_map
from tam_calibration.recordings.choice import choose, resolve
from tam_calibration.recordings.iaga2002 import with_base_station
from tam_calibration.recordings.intake import Intake
from tam_calibration.recordings.joining import Joining, Streams
from tam_calibration.recordings.row_source import RowJoining, RowSource
from tam_calibration.recordings.tables import MemorySource, Reader, Source
from tam_calibration.recordings.text_source import FrameSource, TextReader

if TYPE_CHECKING:
    import pandas

GROUP = "tam_calibration.readers"
"""Entry point group: name and class of each reader."""

log = logging.getLogger(__name__)


@cache
def _readers() -> tuple[Reader, ...]:
    """Return the readers of formats with a mark of their own; text, which has none, comes last."""
    found: list[Reader] = []
    for point in sorted(entry_points(group=GROUP)):
        try:
            found.append(point.load()())
        except Exception as problem:  # the code of another package may raise anything when it is imported
            message = "the reader %s of %s cannot be loaded (%s), and is left out: repair or remove its package"
            log.warning(message, point.name, point.value, problem)
    return (*found, TextReader())


@contextmanager
def open_source(path: Path, channel_map: ChannelMap | None = None) -> Iterator[Source]:
    """Open a recording of whatever format, or the files next to it that a map names.

    Parameters
    ----------
    path : Path
        File, folder of a bag, or one of several files that a map names, or their folder.
    channel_map : ChannelMap, optional
        How it is to be read.

    Raises
    ------
    InputError
        When there is nothing at the path, or it is damaged.
    """
    if not paths.lexists(path):
        raise InputError(f"there is no file or bag {path}")
    if channel_map is not None and channel_map.files:
        yield _joined_files(path if path.is_dir() else path.parent, channel_map)
        return
    require_regular(path)
    beginning = b""
    if path.is_file():
        with path.open("rb") as file:
            beginning = file.read(64)
    reader = next((each for each in _readers() if each.recognises(path, beginning)), None)
    if reader is None:
        raise InputError(f"{path} is a folder and no bag: name a file, or its files in a map")
    with reader.open(path, channel_map) as source:
        yield source


def _joined_files(folder: Path, channel_map: ChannelMap) -> MemorySource:
    """Return the files that a map names as one recording, each a table by its name, which are joined by time.

    Raises
    ------
    InputError
        When one is missing, damaged or contains no rows.
    """
    alone = ChannelMap(sensors=[Pick()], time=channel_map.time, text=channel_map.text)
    columns = []
    for file in [folder / name for name in channel_map.files]:
        with open_source(file, alone) as source, in_file(file):
            columns.append(rows_of(source).in_memory(file.name))
    return MemorySource(folder, f"{len(columns)} files", columns)


def rows_of(source: Source) -> RowSource:
    """Return a source that is one of several files.

    Raises
    ------
    InputError
        When it is no table of rows.
    """
    if not isinstance(source, RowSource):
        raise InputError(
            f"{source.path} is a {source.format}: several files are joined only where each is a table of rows"
        )
    return source


def provenance(path: Path) -> Provenance:
    """Return name, size and SHA-256 of a recording; of a bag's folder those of its data files, one after the other.

    Raises
    ------
    InputError
        When the folder is no bag.
    """
    path = Path(path).resolve()
    digest = sha256()
    parts = data_files(path) if is_bag(path) else sorted(path.iterdir()) if path.is_dir() else [path]
    for part in parts:
        with part.open("rb") as file:
            file_digest(file, lambda: digest)
    return Provenance(printable(path.name), sum(part.stat().st_size for part in parts), digest.hexdigest())


def read_recording(
    path: str | Path,
    sensor_count: int | None = None,
    tolerance_s: float = AS_IT_IS.tolerance_s,
    array: Array | None = None,
    *,
    map: "ChannelMap | Mapping[str, Any] | str | Path | None" = None,
    start: float | str | None = None,
    until: float | str | None = None,
    unwrap: bool = False,
    base_station: str | Path | None = None,
) -> Recording:
    """Read a recording: a bag, a log, a text file or a table. What is missing, or lost in joining, is logged.

    Parameters
    ----------
    path : str or Path
        The file or folder.
    sensor_count : int, optional
        Required number of sensors; by default that of the array, otherwise any.
    tolerance_s : float
        Greatest difference of stamps within a sample, seconds.
    array : Array, optional
        Its delays are removed, and readings and attitude are turned into its axes.
    map : ChannelMap, mapping, str or Path, optional
        Which topics, fields or columns are what: a map, its keys and values, or its YAML file. By default the choice
        is automatic.
    start, until : float or str, optional
        The part that is read: seconds from the start, or ISO 8601 times.
    unwrap : bool
        Whether to continue a sensor's counter across overflows.
    base_station : str or Path, optional
        IAGA-2002 file with the intensity, if the recording has none.

    Returns
    -------
    Recording
        In SI.

    Raises
    ------
    InputError
        When it cannot be read, contains no recording, or the choice is ambiguous.

    Examples
    --------
    >>> from tam_calibration import read_recording, read_scenario, simulate
    >>> simulate(read_scenario("wu_table_1")).recording.to_pandas().to_csv("run.csv")  # fields in T, as b1x_T says
    >>> recording = read_recording("run.csv", sensor_count=4)
    >>> recording.sample_count, recording.scalar_count, recording.temperature_C
    (360, 360, None)
    """
    window = Window.of(start, until)
    station = None if base_station is None else Path(base_station)
    reading = Reading(as_map(map), window, unwrap, station, tolerance_s, sensor_count=sensor_count)
    samples = read_samples(Path(path), array, reading)
    for remark in samples.usage.missing:
        log.warning("%s: %s", path, remark)
    return samples.recording


def recording_of_frame(
    frame: "pandas.DataFrame", map: "ChannelMap | Mapping[str, Any] | str | Path | None" = None
) -> Recording:
    """Return the recording that a table of pandas contains, as `Recording.from_pandas` describes."""
    channel_map = as_map(map)
    source = FrameSource(Path("the table"), frame, TimeColumn() if channel_map is None else channel_map.time_column)
    streams = streams_of(source, Reading(channel_map))
    return RowJoining(source, streams, AS_IT_IS, None).whole().recording


def read_samples(
    path: Path, array: Array | None = None, reading: Reading = AS_IT_IS, progress: Progress = lambda done, total: None
) -> Samples:
    """Read a recording complete, with the exact stamps of a bag.

    Parameters
    ----------
    path : Path
        The file or folder.
    array : Array, optional
        Its delays are removed, and readings and attitude are turned into its axes.
    reading : Reading
        How it is read.
    progress : callable
        Called now and then with what is done, and how much there is to do.

    Raises
    ------
    InputError
        When it cannot be read, or contains no recording.
    """
    with _joining(path, array, reading) as joining:
        return with_base_station(joining.whole(progress), reading.base_station)


def read_pieces(
    path: Path, array: Array | None = None, reading: Reading = AS_IT_IS, progress: Progress = lambda done, total: None
) -> Iterator[Samples]:
    """Yield a recording as `read_samples` returns it, in pieces of bounded size.

    The pieces follow each other in time without a sample lost or doubled. A channel without a value in a complete piece
    is None in that piece. With a base station, whose values are shifted by a median of all, there is one piece.

    Parameters
    ----------
    path, array, reading, progress
        As of `read_samples`.

    Raises
    ------
    InputError
        When it cannot be read, or contains no recording; pieces before the fault have been yielded by then.
    """
    if reading.base_station is not None:
        yield read_samples(path, array, reading, progress)
        return
    with _joining(path, array, reading) as joining:
        yield from joining.pieces(progress)


@contextmanager
def _joining(path: Path, array: Array | None, reading: Reading) -> Iterator[Joining | RowJoining]:
    """Open a recording, and give what joins its streams."""
    path = Path(path)
    with open_source(path, reading.channel_map) as source, in_file(path):
        streams = streams_of(source, reading, array)
        own = streams, reading, array
        joining = RowJoining(source, *own) if isinstance(source, RowSource) else Joining(source, *own)
        yield joining
        tell_taken(source, joining.streams, joining.intakes)


def streams_of(source: Source, reading: Reading, array: Array | None = None) -> Streams:
    """Return what is read of a source, by its map or by choice.

    Parameters
    ----------
    source : Source
        An open recording.
    reading : Reading
        How it is read.
    array : Array, optional
        Whose number of sensors and frames help to choose.

    Raises
    ------
    InputError
        When it is ambiguous, or the number of sensors is another.
    """
    channel_map, has_sure_units, order = reading.channel_map, True, ""
    sensor_count = reading.sensor_count if array is None else array.sensor_count
    if channel_map is None:
        choice = choose(source, sensor_count, None if array is None else array.mounting.frame_ids)
        if choice.channel_map is None or choice.doubts:
            raise InputError(
                f"{'; '.join(choice.doubts)}; `tam inspect {source.path} --write-map map.yaml` writes one to edit"
            )
        channel_map, has_sure_units, order = choice.channel_map, choice.is_own, choice.order
        is_plain = choice.is_own and not choice.remarks
        taken = "" if is_plain else f"taken as {'; '.join((str(channel_map), *choice.remarks))}"
    else:
        taken = f"taken by the map as {channel_map}"
    if sensor_count not in (None, len(channel_map.sensors)):
        raise InputError(f"the recording has {len(channel_map.sensors)} sensors, not {sensor_count}")
    return replace(resolve(source, channel_map, has_sure_units), taken=taken, order=order)


def tell_taken(source: Source, streams: Streams, intakes: Mapping[str, Intake]) -> None:
    """Log what was taken of a recording that was read, and the units that were detected."""
    if streams.taken:
        log.info("%s: %s", source.path, streams.taken)
    if units := [f"{in_words(name)} {intake.unit}" for name, intake in intakes.items() if intake.is_detected]:
        log.info("units by the size of the field: %s", ", ".join(units))
