"""The folder of a bag: its metadata, and the files that hold its messages."""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar

from tam_calibration.files.bag_storages import STORAGES
from tam_calibration.files.schema import check
from tam_calibration.files.text_files import read_text
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.model.exceptions import InputError

METADATA = "metadata.yaml"
INFORMATION = "rosbag2_bagfile_information"

PACKED = ".zstd"
"""Suffix behind that of a file that is packed as a whole."""


def data_files(path: Path) -> list[Path]:
    """Return the files that hold the messages of a bag, in their order; a single file is its own.

    Raises
    ------
    InputError
        When the path is no bag.
    """
    if not path.is_dir():
        files = [path]
    elif (metadata := read_metadata(path)) is not None:
        files = [path / Path(name).name for name in metadata["relative_file_paths"]]
    else:
        files = _found_in(path)
    for file in files:
        if file.is_dir():
            raise InputError(f"{file} is a folder, not a file of a bag")
    return files


@dataclass(frozen=True)
class _Nanoseconds:
    nanoseconds: int


@dataclass(frozen=True)
class _SinceEpoch:
    nanoseconds_since_epoch: int


@dataclass(frozen=True)
class _Topic:
    may_hold_more: ClassVar = True

    name: str
    type: str
    serialization_format: str


@dataclass(frozen=True)
class _Count:
    may_hold_more: ClassVar = True

    message_count: int
    topic_metadata: _Topic


@dataclass(frozen=True)
class _Metadata:
    """What rosbags reads of the metadata; those of newer versions hold more."""

    may_hold_more: ClassVar = True

    version: int
    storage_identifier: str
    relative_file_paths: list[Any]
    message_count: int
    duration: _Nanoseconds
    starting_time: _SinceEpoch
    topics_with_message_count: list[_Count]
    files: list[Any] = field(default_factory=list)
    compression_mode: str = ""


def read_metadata(folder: Path) -> dict[str, Any] | None:
    """Return the metadata of a bag; None where the recorder did not write them, or not to the end, or they are none."""
    try:
        information: dict[str, Any] = parse_mapping(read_text(folder / METADATA))[INFORMATION]
        files = check(information, _Metadata).relative_file_paths
    except (InputError, KeyError):
        return None
    return information | {"relative_file_paths": [str(name) for name in files]}


def _found_in(folder: Path) -> list[Path]:
    """Return the files that a recorder left without metadata, by the numbers in their names."""
    suffixes = tuple(storage.suffix for storage in STORAGES.values())
    files = [each for each in folder.iterdir() if each.name.removesuffix(PACKED).endswith(suffixes)]
    names = {each.name for each in files}
    # The recorder packs a file beside it, and removes it then.
    files = [each for each in files if each.name == each.name.removesuffix(PACKED) or each.stem not in names]
    if not files:
        kinds = " or ".join(suffixes)
        raise InputError(f"{folder} holds no {METADATA}, nor a file that ends in {kinds}: is it a bag?")
    if len(recordings := sorted({re.sub(r"_\d+$", "", each.name.partition(".")[0]) for each in files})) > 1:
        raise InputError(
            f"{folder} holds no {METADATA}, but files of several recordings, {recordings[0]} and {recordings[1]} among "
            "them: name one of them"
        )
    return sorted(files, key=_in_order)


def _in_order(path: Path) -> list[tuple[str, int]]:
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]
