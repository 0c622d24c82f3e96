"""Telling in which file a problem lies."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tam_calibration.exceptions import InputError


@contextmanager
def in_file(path: Path | str) -> Iterator[None]:
    """Put the name of a file before the message of an `InputError`."""
    try:
        yield
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def read_text(path: Path) -> str:
    """Return the text of a file.

    Raises
    ------
    InputError
        When there is no such file, it cannot be read, is empty or is not text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as problem:
        raise InputError(f"{path} cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None
    if not text.strip():
        raise InputError(f"{path} is empty")
    return text
