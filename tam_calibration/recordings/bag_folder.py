"""The folder of a bag: its metadata, and the files that hold its messages."""

import re
from dataclasses import dataclass
from pathlib import Path

from tam_calibration.files.text_files import read_text
from tam_calibration.files.yaml_document import parse_mapping
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_storages import STORAGES

METADATA = "metadata.yaml"

PACKED = ".zstd"
"""Suffix behind that of a packed file."""


@dataclass(frozen=True)
class Metadata:
    """The part of a bag's metadata that its files do not tell, the same in all versions since Foxy.

    Parameters
    ----------
    files : tuple of str
        Names of the data files, in their order.
    counts : dict of str to int
        Messages of each topic.
    """

    files: tuple[str, ...]
    counts: dict[str, int]


def read_metadata(folder: Path) -> Metadata | None:
    """Return the metadata of a bag; None where the recorder did not write them to their end, or they are damaged."""
    try:
        information = parse_mapping(read_text(folder / METADATA))["rosbag2_bagfile_information"]
        files = dict.fromkeys(Path(str(path)).name for path in information["relative_file_paths"])
        topics = information["topics_with_message_count"]
        return Metadata(tuple(files), {str(each["topic_metadata"]["name"]): each["message_count"] for each in topics})
    except (InputError, LookupError, TypeError):
        return None


def data_files(path: Path) -> list[Path]:
    """Return the files that hold the messages of a bag, in their order; a single file is its own.

    Raises
    ------
    InputError
        When the path is no bag.
    """
    if not path.is_dir():
        return [path]
    metadata = read_metadata(path)
    files = _found_in(path) if metadata is None else [path / name for name in metadata.files]
    for file in files:
        if file.is_dir():
            raise InputError(f"{file} is a folder, not a file of a bag")
    return files


def _found_in(folder: Path) -> list[Path]:
    """Return the files that a recorder left without metadata, by the numbers in their names."""
    suffixes = tuple(storage.suffix for storage in STORAGES.values())
    files = [each for each in folder.iterdir() if each.name.removesuffix(PACKED).endswith(suffixes)]
    names = {each.name for each in files}
    # The recorder writes the packed file next to the original, which it then removes.
    files = [each for each in files if each.name == each.name.removesuffix(PACKED) or each.stem not in names]
    if not files:
        kinds = " or ".join(suffixes)
        raise InputError(f"{folder} contains no {METADATA}, nor a file that ends in {kinds}: is it a bag?")
    if len(recordings := sorted({re.sub(r"_\d+$", "", each.name.partition(".")[0]) for each in files})) > 1:
        raise InputError(
            f"{folder} contains no {METADATA}, but files of several recordings, {recordings[0]} and {recordings[1]} "
            "among them: name one of them"
        )
    return sorted(files, key=_in_order)


def _in_order(path: Path) -> list[tuple[str, int]]:
    return [(text, int(number or 0)) for text, number in re.findall(r"(\D*)(\d*)", path.name)]
