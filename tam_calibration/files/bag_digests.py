"""Digests of a bag's files beside them, which tell that a file is not what was written; other readers ignore them."""

import json
from hashlib import sha256
from pathlib import Path
from typing import Any

from tam_calibration.model.exceptions import InputError

DIGESTS = "digests.json"

_LARGEST = 1 << 20
"""Bytes of the file that are read at most, 1 MiB: those of some ten thousand files."""


def write_digests(folder: Path) -> None:
    """Write size and SHA-256 of every file in a folder."""
    files = sorted(file for file in folder.iterdir() if file.is_file())
    digests = {file.name: {"bytes": file.stat().st_size, "sha256": _digest(file)} for file in files}
    (folder / DIGESTS).write_text(json.dumps(digests, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


def changed_files(folder: Path) -> list[Path] | None:
    """Return the files that are not what was written; None where no digests tell.

    A file that is shorter than it was is left out, as one that is gone: it was cut, and its beginning may be whole.

    Raises
    ------
    InputError
        When the digests cannot be read.
    """
    path = folder / DIGESTS
    if not path.is_file():
        return None
    changed = []
    for name, size, digest in _read(path):
        file = folder / name
        if file.is_file() and file.stat().st_size >= size and _digest(file) != digest:
            changed.append(file)
    return changed


def are_complete(folder: Path) -> bool:
    """Return whether all files are there in their length, by their digests."""
    sizes = [(folder / name, size) for name, size, _ in _read(folder / DIGESTS)]
    return all(file.is_file() and file.stat().st_size == size for file, size in sizes)


def _read(path: Path) -> list[tuple[str, int, str]]:
    try:
        with path.open("rb") as file:
            content: dict[str, dict[str, Any]] = json.loads(file.read(_LARGEST))
        return [(Path(name).name, int(each["bytes"]), str(each["sha256"])) for name, each in content.items()]
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        raise InputError(f"{path} is damaged: remove it to read the bag without its digests") from None


def _digest(path: Path) -> str:
    digest = sha256()
    with path.open("rb") as file:
        while block := file.read(1 << 20):
            digest.update(block)
    return digest.hexdigest()
