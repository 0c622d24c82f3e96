"""Which recordings some patterns name: CSV files, and bags as single files or folders."""

from collections.abc import Iterable, Iterator
from glob import glob, has_magic
from pathlib import Path

from tam_calibration.exceptions import InputError

_SUFFIXES = (".csv", ".mcap", ".db3", ".zstd")
_METADATA = "metadata.yaml"


def find_recordings(patterns: Iterable[str], without: Path) -> list[Path]:
    """Return the recordings that patterns name, each once, sorted by their absolute paths.

    A file of a bag's folder stands for the bag. A pattern such as ``missions/**`` finds bags and files that end in
    .csv, .mcap or .db3; a name without ``*``, ``?`` or ``[`` is taken as it is.

    Parameters
    ----------
    patterns : iterable of str
        As of a shell, where ``**`` stands for any number of folders.
    without : Path
        Folder in which nothing is looked for.

    Raises
    ------
    InputError
        When a pattern finds nothing.
    """
    without = without.resolve()
    found: set[Path] = set()
    for pattern in patterns:
        here = {path for path in _matches(pattern) if not path.is_relative_to(without)}
        if not here:
            raise InputError(
                f"no recording is found by {pattern}: name bags or CSV files, as in 'missions/**/*.mcap' (with quotes)"
            )
        found |= here
    return sorted(found)


def _matches(pattern: str) -> Iterator[Path]:
    if Path(pattern).exists() or not has_magic(pattern):
        path = Path(pattern).resolve()
        if path.exists():
            yield _bag_of(path)
        return
    for name in glob(pattern, recursive=True):
        path = _bag_of(Path(name).resolve())
        if (path / _METADATA).is_file() or (path.suffix in _SUFFIXES and path.is_file()):
            yield path


def _bag_of(path: Path) -> Path:
    """Return the folder of the bag of which a path is a part, else the path."""
    is_part = path.suffix in _SUFFIXES[1:] and path.is_file() and (path.parent / _METADATA).is_file()
    return path.parent if is_part else path
