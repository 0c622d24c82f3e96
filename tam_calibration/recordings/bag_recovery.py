"""Files of bags as far as they can be read: packed ones unpacked, and the complete messages of unfinished ones."""

import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tam_calibration.files.whole_files import temporary_place
from tam_calibration.messages.cdr import RawMessages, gather
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_bounds import NAMED, NO_ROOM, unpack_file
from tam_calibration.recordings.bag_storages import PACKED, storage_for

if TYPE_CHECKING:
    from rosbags.interfaces import Connection


@dataclass(frozen=True)
class Recovered:
    """The complete messages of a bag.

    Parameters
    ----------
    messages : int
        How many messages.
    first_ns, last_ns : int
        When the first and the last of them were recorded, nanoseconds.
    faults : tuple of str
        Parts that were left out, as clauses.
    """

    messages: int
    first_ns: int
    last_ns: int
    faults: tuple[str, ...]

    def __str__(self) -> str:
        """Return a clause for people."""
        duration_s = (self.last_ns - self.first_ns) / 1e9
        ends = f"the recording ends at {self.last_ns / 1e9:.3f} s, {duration_s:.3f} s after it began"
        more = len(self.faults) - NAMED
        lost = [*self.faults[:NAMED], *([f"{more} faults more"] if more > 0 else [])]
        return f"{self.messages} complete messages are recovered, {ends}{''.join(f'; {each}' for each in lost)}"


class RecoveredFile:
    """The complete messages of a file without an end or an index; each pass finds them anew.

    Parameters
    ----------
    path : Path
        The file.
    faults : list of str
        Takes a clause for each part that is left out.
    """

    def __init__(self, path: Path, faults: list[str]) -> None:
        self.path, self._storage = path, storage_for(path)
        found: dict[int, Connection] = {}
        counts, empty = Counter[int](), Counter[str]()
        self.start_ns, self.end_ns = sys.maxsize, 0
        for one, recorded_ns, content in self._storage.complete_messages(path, faults):
            if not content:
                empty[one.topic] += 1
                continue
            found[one.id] = one
            counts[one.id] += 1
            self.start_ns, self.end_ns = min(self.start_ns, recorded_ns), max(self.end_ns, recorded_ns)
        faults += [f"empty messages of {topic}: {count} left out" for topic, count in empty.items()]
        self.connections: Sequence[Connection] = [one._replace(msgcount=counts[one.id]) for one in found.values()]
        self.message_count = counts.total()

    def blocks(self, position: Mapping[int, int]) -> Iterator[tuple[RawMessages, int]]:
        """Yield messages as ``StoredFile`` asks.

        Parameters
        ----------
        position : mapping of int to int
            For the id of each wanted connection its number in the messages.
        """
        messages = self._storage.complete_messages(self.path, [])
        wanted = (
            (position[one.id], recorded_ns, content)
            for one, recorded_ns, content in messages
            if one.id in position and content
        )
        for block, size in gather(wanted, self.path.stat().st_size / self.message_count):
            yield block.take(np.argsort(block.recorded_ns, kind="stable")), size


@contextmanager
def room_named(path: Path) -> Iterator[None]:
    """Explain that a disk has no room for the temporary files of a bag."""
    try:
        yield
    except (OSError, InputError) as problem:
        cause = problem if isinstance(problem, OSError) else problem.__cause__
        if not isinstance(cause, OSError) or cause.errno not in NO_ROOM:
            raise
        place = temporary_place().parent
        raise InputError(
            f"{path} cannot be unpacked or recovered in {place}: {cause.strerror}; let TMPDIR name a folder with room"
        ) from cause


def unpacked(files: list[Path], folder: Path, faults: list[str] | None = None) -> list[Path]:
    """Return the files of a bag, packed ones unpacked into a folder.

    Parameters
    ----------
    files : list of Path
        As they are in the bag.
    folder : Path
        Where they are unpacked.
    faults : list of str, optional
        Takes a clause for each file that is damaged and unpacked in part; without it that is an error.
    """
    targets = []
    for file in files:
        target = folder / file.name.removesuffix(PACKED) if file.suffix == PACKED and file.exists() else file
        targets.append(target)
        if target == file:
            continue
        try:
            unpack_file(file, target)
        except Exception as problem:
            if faults is None or (isinstance(problem, OSError) and problem.errno in NO_ROOM):
                raise
            faults.append(f"{file.name} cannot be unpacked to its end")
    return targets
