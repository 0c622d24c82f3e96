"""Which recording a result came from."""

from hashlib import sha256
from pathlib import Path

from tam_calibration.calibration import Provenance
from tam_calibration.files.location import read_text
from tam_calibration.files.yaml_document import parse_mapping


def provenance(path: Path) -> Provenance:
    """Return name, size and SHA-256 of a recording; of a bag's folder those of its data files, one after the other.

    Raises
    ------
    InputError
        When the folder is no bag.
    """
    path = Path(path).resolve()
    digest, size = sha256(), 0
    for part in _data_files(path):
        with part.open("rb") as file:
            while block := file.read(1 << 20):
                digest.update(block)
                size += len(block)
    return Provenance(path.name, size, digest.hexdigest())


def _data_files(path: Path) -> list[Path]:
    if not path.is_dir():
        return [path]
    metadata = parse_mapping(read_text(path / "metadata.yaml"))
    return [path / Path(name).name for name in metadata["rosbag2_bagfile_information"]["relative_file_paths"]]
