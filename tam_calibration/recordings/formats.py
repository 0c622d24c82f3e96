"""The readers of all formats: those of this package, and what others offer under ``tam_calibration.readers``."""

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from importlib.metadata import entry_points
from os import path as paths
from pathlib import Path

from tam_calibration.files.text_files import in_file, require_regular
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.channel_map import ChannelMap, Pick
from tam_calibration.recordings.row_source import RowSource
from tam_calibration.recordings.tables import MemorySource, Reader, Source
from tam_calibration.recordings.text_source import TextReader

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
    names = [] if channel_map is None else channel_map.files
    if names:
        folder = path if path.is_dir() else path.parent
        with open_files([folder / name for name in names], channel_map) as source:
            yield source
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


@contextmanager
def open_files(files: list[Path], channel_map: ChannelMap | None = None) -> Iterator[Source]:
    """Open several files of rows as one recording, each a table by its name, which are joined by time.

    Raises
    ------
    InputError
        When one is missing, damaged or contains no rows.
    """
    alone = None if channel_map is None else ChannelMap(sensors=[Pick()], time=channel_map.time, text=channel_map.text)
    columns = []
    for file in files:
        with open_source(file, alone) as source, in_file(file):
            columns.append(rows_of(source).in_memory(file.name))
    yield MemorySource(files[0].parent, f"{len(files)} files", columns)


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
