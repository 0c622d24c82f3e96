"""Writing whole or not at all: beside the target, then renamed."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from tam_calibration.exceptions import InputError


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Give a place to write a file or folder to, and move it to its path when that went well.

    A file that was there is replaced at once; a folder that was there is never replaced. After a failure
    everything is as it was.

    Parameters
    ----------
    path : Path
        Where the file or folder shall be.

    Yields
    ------
    Path
        Path of the same name in a temporary folder beside the target.

    Raises
    ------
    InputError
        When the target cannot be written.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path} is a folder that exists already: choose another name, or remove it")
    if path.exists() and not path.is_file():
        raise InputError(f"{path} is not a regular file: choose another name")
    try:
        folder = TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent)
    except OSError as problem:
        raise InputError(f"{path} cannot be written: {problem.strerror} ({path.parent})") from None
    with folder as name:
        beside = Path(name, path.name)
        try:
            yield beside
            os.replace(beside, path)
        except OSError as problem:
            if problem.filename is None or str(problem.filename).startswith(name):
                raise InputError(f"{path} cannot be written: {problem.strerror}") from problem
            raise
