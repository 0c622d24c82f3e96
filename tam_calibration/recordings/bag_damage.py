"""What is damaged in a bag, in words."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tam_calibration.model.exceptions import InputError

NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
"""Error numbers of a disk without room: the input is not at fault."""

NAMED = 3
"""Faults that a sentence names."""

_TELLING = {"tam_calibration", "rosbags", "zstandard", "apsw"}
"""Packages whose exceptions are sentences for people."""


class Damaged(InputError):
    """A part of a bag is not what was written; other parts may be complete."""


@contextmanager
def damage_named(path: Path, may_recover: bool = True) -> Iterator[None]:
    """Turn whatever is wrong with the content of a bag into one sentence with the bag's name.

    Parameters
    ----------
    path : Path
        The bag.
    may_recover : bool
        Whether `tam recover` is advised.

    Raises
    ------
    InputError
        For every exception within, except that a disk is full.
    """
    try:
        yield
    except Exception as problem:  # rosbags lets through whatever its decompressors and databases raise
        if isinstance(problem, OSError) and problem.errno in NO_ROOM:
            raise
        if isinstance(problem, InputError) and not isinstance(problem, Damaged):
            raise InputError(f"{path} cannot be read: {problem}") from problem
        is_advised = may_recover and path.suffix != ".bag"
        advice = f"; `tam recover {path} -o NEW` keeps the complete messages" if is_advised else ""
        raise InputError(f"{path} is damaged or truncated: {reason_of(problem)}{advice}") from problem


def reason_of(problem: Exception) -> str:
    """Return what an exception says, unless it is one of Python itself."""
    if isinstance(problem, OSError) and problem.strerror:
        return problem.strerror
    is_telling = type(problem).__module__.partition(".")[0] in _TELLING
    return (" ".join(str(problem).split()) if is_telling else "") or "its parts do not fit together"
