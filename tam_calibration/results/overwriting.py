"""What is written costs nothing that is stored: no output is an input or another recording, nor lies inside a bag."""

import os
import re
from collections.abc import Hashable, Iterable
from contextlib import suppress
from pathlib import Path
from unicodedata import normalize

from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_storages import METADATA, STORAGES, is_bag
from tam_calibration.recordings.times import time_unit


def require_separate(outputs: Iterable[Path], inputs: Iterable[Path]) -> None:
    """Check that writing outputs overwrites no input, no recording but those of this package, and no other output.

    Every command calls this before it begins to work. Names that differ in their case alone, other paths and links to
    the same file count as the same, as they are the same on some disks.

    Parameters
    ----------
    outputs : iterable of Path
        Files and folders that will be written.
    inputs : iterable of Path
        Files and folders that are read.

    Raises
    ------
    InputError
        When an output is an input, a recording or another output, lies inside one, or contains an input.
    """
    inputs = list(inputs)
    taken = {key for path in inputs for key in _keys(path) | _parts(path)}
    for output in outputs:
        require_outside_bags(output)
        own = _keys(output)
        if own & taken:
            raise InputError(f"{output} would be overwritten: choose another name for the output")
        if output.is_file() and (is_bag(output) or _is_others_table(output)):
            raise InputError(f"{output} is a recording that exists already: choose another name, or remove it")
        for path in inputs:
            if _folders(output) & _place(path):
                raise InputError(f"{output} lies inside {path}, which is read: choose a place outside it")
            if _folders(path) & _place(output):
                raise InputError(f"{path} would be overwritten: it lies inside {output}, which is written")
        taken |= own


def require_outside_bags(output: Path) -> None:
    """Check that an output lies inside no bag's folder.

    Parameters
    ----------
    output : Path
        File or folder that will be written.

    Raises
    ------
    InputError
        When it does.
    """
    for path in _paths(output):
        for folder in path.parents:
            if _holds_bag(folder):
                raise InputError(f"{output} lies inside the bag {folder}: choose a place outside it")


def _holds_bag(folder: Path) -> bool:
    """Return whether a folder is a bag, also one whose recorder was killed before it wrote the metadata."""
    with suppress(OSError):
        begin = "" if (folder / METADATA).exists() else f"{folder.name}_"  # as recorders name the files of a bag
        suffixes = tuple(storage.suffix for storage in STORAGES.values())
        names = [each.name for each in folder.iterdir() if each.name.startswith(begin)]
        return any(suffix in name for name in names for suffix in suffixes)
    return False


def _is_others_table(path: Path) -> bool:
    """Return whether a .csv may hold readings that this package did not write, by a time and three axes in its header.

    Corrected data begin with the centre vector, and the truth of a simulation lies in the same folder.
    """
    if path.suffix != ".csv" or path.with_suffix(".truth.yaml").exists():
        return False
    with path.open(encoding="utf-8", errors="replace") as file:
        header = file.readline(1 << 16)
    names = re.split(r"[,;\t]", header)
    has_time = any(time_unit(name) is not None for name in names)
    return has_time and len(names) > 3 and not header.startswith("time_s,bx_nT,")


def _paths(path: Path) -> set[Path]:
    """Return a path without links among its folders, and where it leads to as a link; none for what names no file."""
    if "\0" in str(path):
        return set()
    here = os.path.join(os.path.realpath(path.parent), path.name)
    return {Path(os.path.normpath(here)), Path(os.path.realpath(path))}


def _keys(path: Path) -> set[Hashable]:
    """Return by what a file or folder is known: its names, whatever their case, and its place on the disk."""
    return {normalize("NFC", str(each)).casefold() for each in _paths(path)} | _place(path)


def _parts(path: Path) -> set[Hashable]:
    """Return the places on the disk of what a folder contains; empty for what is no folder."""
    with suppress(OSError, ValueError):
        return {place for each in path.iterdir() for place in _place(each)}
    return set()


def _folders(path: Path) -> set[Hashable]:
    """Return the places on the disk of all folders that a path lies in."""
    return {place for each in _paths(path) for folder in each.parents for place in _place(folder)}


def _place(path: Path) -> set[Hashable]:
    """Return device and number of a file or folder, which tell it from all others; empty where there is none."""
    with suppress(OSError, ValueError):
        state = os.stat(path)
        return {(state.st_dev, state.st_ino)}
    return set()


def name_aside(path: Path) -> Path:
    """Return an unused name next to a path, for a file that is to be kept: the path with a number at its end."""
    names = (path.with_name(f"{path.name}.{number}") for number in range(1, 1_000_000))
    return next(name for name in names if not name.exists())
