"""The folder of a bag: its metadata, and the files that hold its messages."""

import re
from pathlib import Path
from typing import Any

from tam_calibration.files.bag_storages import STORAGES
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


def read_metadata(folder: Path) -> dict[str, Any] | None:
    """Return the metadata of a bag; None where the recorder did not write them, or not to the end."""
    try:
        information: dict[str, Any] = parse_mapping(read_text(folder / METADATA))[INFORMATION]
        information["relative_file_paths"] = [str(name) for name in information["relative_file_paths"]]
    except (InputError, KeyError, TypeError):
        return None
    return information


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
    return sorted(files, key=_in_order)


def _in_order(path: Path) -> list[tuple[str, int]]:
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]
