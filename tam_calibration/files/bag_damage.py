"""What is damaged in a bag, in words."""

import errno
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tam_calibration.model.exceptions import InputError

NO_ROOM = (errno.ENOSPC, errno.EFBIG, errno.EDQUOT)
"""Numbers of errors of a disk on which there is no room: no fault of what is read."""

NAMED = 3
"""Stretches of messages, or faults, that a sentence names."""

_TELLING = {"tam_calibration", "rosbags", "zstandard", "sqlite3", "apsw"}
"""Whose exceptions are sentences for people."""


class Damage(NamedTuple):
    """Messages of a topic that follow each other: their numbers, from 1 on, and when they were recorded."""

    topic: str
    first: int
    last: int
    from_ns: int
    to_ns: int

    def __str__(self) -> str:
        """Return them as a clause."""
        numbers = f"message {self.first}" if self.first == self.last else f"messages {self.first} to {self.last}"
        return f"{numbers} of {self.topic}, recorded at {_span(self.from_ns, self.to_ns)}"


def describe(damages: Sequence[Damage]) -> str:
    """Return a clause that names damaged messages; nothing where there are none."""
    if not damages:
        return ""
    rest = sum(each.last - each.first + 1 for each in damages[NAMED:])
    more = [f"{rest} more"] if rest else []
    return "damaged: " + "; ".join([*map(str, damages[:NAMED]), *more])


def _span(from_ns: int, to_ns: int) -> str:
    begin, end = (f"{time_ns / 1e9:.3f}" for time_ns in (from_ns, to_ns))
    return f"{begin} s" if begin == end else f"{begin} s to {end} s"


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Have what is wrong with the content of a bag told in one sentence, with the bag's name.

    Raises
    ------
    InputError
        Whatever was raised within, but that a disk is full.
    """
    try:
        yield
    except Exception as problem:  # rosbags lets through whatever its decompressors and databases raise
        if isinstance(problem, OSError) and problem.errno in NO_ROOM:
            raise
        raise InputError(f"{path} is damaged or truncated: {_reason(problem)}") from problem


def _reason(problem: Exception) -> str:
    """Return what an exception tells; of those of Python itself that it does not fit together."""
    if isinstance(problem, OSError) and problem.strerror:
        return problem.strerror
    is_telling = type(problem).__module__.partition(".")[0] in _TELLING
    told = " ".join(str(problem).split()) if is_telling else ""
    if not isinstance(problem, InputError) and problem.__cause__ is not None:
        told = told.partition(":")[0]  # behind it stands what Python said
    return told or "what it holds does not fit together"
