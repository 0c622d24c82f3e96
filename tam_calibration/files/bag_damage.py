"""What is damaged in a bag, in words."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from tam_calibration.model.exceptions import InputError

_NAMED = 3
"""Topics, or stretches of a topic, that a sentence names."""


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
    rest = sum(each.last - each.first + 1 for each in damages[_NAMED:])
    more = [f"{rest} more"] if rest else []
    return "damaged: " + "; ".join([*map(str, damages[:_NAMED]), *more])


def _span(from_ns: int, to_ns: int) -> str:
    begin, end = (f"{time_ns / 1e9:.3f}" for time_ns in (from_ns, to_ns))
    return f"{begin} s" if begin == end else f"{begin} s to {end} s"


@contextmanager
def damage_named(path: Path) -> Iterator[None]:
    """Have what is wrong with the content of a bag told in one sentence, with the bag's name.

    Raises
    ------
    InputError
        Whatever was raised within.
    """
    try:
        yield
    except Exception as problem:  # rosbags lets through whatever its decompressors and databases raise
        reason = str(problem).partition("\n")[0] or type(problem).__name__
        raise InputError(f"{path} is damaged or truncated: {reason}") from problem
