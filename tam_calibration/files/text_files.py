"""Text files: written completely or not at all, errors with the file's name, and the folder ``config/``."""

import json
import math
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tam_calibration.files.whole_files import write_set
from tam_calibration.model.exceptions import InputError


@contextmanager
def in_file(path: Path | str) -> Iterator[None]:
    """Put the name of a file, or of a topic, before the message of an `InputError` that does not begin with it."""
    try:
        yield
    except InputError as problem:
        sentence = str(problem)
        raise InputError(sentence if sentence.startswith((f"{path} ", f"{path}:")) else f"{path}: {sentence}") from None


@contextmanager
def readable(path: Path) -> Iterator[None]:
    """Tell in one sentence that a file cannot be read, or is no text file.

    Parameters
    ----------
    path : Path
        The file that the body reads.

    Raises
    ------
    InputError
        When it cannot be read.
    """
    try:
        yield
    except OSError as problem:
        raise InputError(f"{path} cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None


MOST_BYTES = 1 << 26
"""Of a text that is read at once: four times the largest calibration, and a century of an observatory's hours."""


def require_regular(path: Path) -> None:
    """Check that what is to be read is a regular file, or a folder with no other things in it.

    A device may have no end, and a pipe no beginning.

    Parameters
    ----------
    path : Path
        A link is followed.

    Raises
    ------
    InputError
        When it is something else, or leads nowhere.
    """
    with readable(path):
        path.stat()
        parts = list(path.iterdir()) if path.is_dir() else []
    for each in (path, *parts):
        if each.exists() and not (each.is_file() or each.is_dir()):
            raise InputError(f"{each} is no regular file but a device, pipe or socket: copy what it gives into a file")


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        When there is no such file, it cannot be read, is too long, empty or not text.
    """
    require_regular(path)
    with readable(path):
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"{path} has {path.stat().st_size} bytes, and at most {MOST_BYTES} are read of a text")
        text = path.read_text(encoding="utf-8-sig")
    if not text.strip():
        raise InputError(f"{path} is empty")
    return text


def check_writable(path: str) -> None:
    """Check that a file could be written; an empty path is none.

    Raises
    ------
    InputError
        When its folder is not there or cannot be written to, or it is no file itself.
    """
    folder = Path(path).parent
    if not path:
        return
    if Path(path).is_dir():
        raise InputError(f"{path} is a folder: name a file")
    if Path(path).exists() and not Path(path).is_file():
        raise InputError(f"{path} is no regular file but a device, pipe or socket: name a file")
    if not folder.is_dir():
        raise InputError(f"{path} cannot be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK):
        raise InputError(f"{path} cannot be written: {folder} is write-protected")


@contextmanager
def write_whole(path: Path) -> Iterator[Path]:
    """Give a place to write a file or folder to, and move it to its path as `write_set` does.

    Parameters
    ----------
    path : Path
        Where the file or folder shall be.

    Yields
    ------
    Path
        Path of the same name in a temporary folder next to the target.

    Raises
    ------
    InputError
        When the target cannot be written.
    """
    with write_set([path]) as [temporary]:
        yield temporary


def write_text(path: Path, text: str) -> None:
    """Write a text file, completely or not at all.

    Raises
    ------
    InputError
        When it cannot be written.
    """
    with write_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def to_json(content: Mapping[str, Any]) -> str:
    """Return JSON text; NaN and infinity, which JSON has not, become null."""
    return json.dumps(_without_nan(content), ensure_ascii=False, indent=1)


def _without_nan(content: Any) -> Any:
    if isinstance(content, Mapping):
        return {key: _without_nan(value) for key, value in content.items()}
    if isinstance(content, list | tuple):
        return [_without_nan(value) for value in content]
    return None if isinstance(content, float) and not math.isfinite(content) else content


def configuration_folder() -> Path:
    """Return the folder ``config/`` that belongs to this package, however it was installed.

    In a source tree, to which an editable install and ``colcon build --symlink-install`` lead too, it is next to the
    package. Any other install has it in ``share/tam_calibration/config`` of a folder above the package, as
    ``/usr/share/tam_calibration/config`` for ``/usr/lib/python3/dist-packages/tam_calibration``.

    Raises
    ------
    InputError
        When it is in none of these places.
    """
    package = Path(__file__).resolve().parents[1]
    places = [package.parent / "config", *(folder / "share" / package.name / "config" for folder in package.parents)]
    for place in places:
        if (place / "tam.yaml").is_file():  # another package's folder may have the name config too
            return place
    raise InputError(
        f"the folder config is missing: it is neither next to {package}, nor share/{package.name}/config above it; "
        f"install {package.name} again"
    )
