"""Bags made readable: unpacked, checked, and what a recorder left unfinished written anew to a temporary folder."""

import logging
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from functools import lru_cache
from glob import escape
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import finalize

from tam_calibration.files.text_files import require_regular
from tam_calibration.files.whole_files import temporary_place, unfinished
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings.bag_blocks import gather
from tam_calibration.recordings.bag_bounds import unpack_bounded, unpack_file
from tam_calibration.recordings.bag_damage import NAMED, NO_ROOM, Damaged, damage_named
from tam_calibration.recordings.bag_folder import PACKED, data_files, read_metadata
from tam_calibration.recordings.bag_storages import (
    READABLE,
    Condition,
    StoredFile,
    serialisation_of,
    storage_for,
    storage_of,
)

if TYPE_CHECKING:  # bag_writing takes a third of a second to load, and most bags need no recovery
    from tam_calibration.recordings.bag_writing import BlockWriter

ZSTD_BEGINNING = b"\x28\xb5\x2f\xfd"
"""First bytes of a message that was compressed by itself; no serialised message of ROS 2 begins so."""


log = logging.getLogger(__name__)


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


class ReadableBag:
    """A bag as it can be read.

    Attributes
    ----------
    files : list of StoredFile
        Its files, or their replacements in a temporary folder that is removed with this object.
    is_unfinished : bool
        Whether its recorder did not finish it.
    faults : tuple of str
        Parts that had to be left out then, as clauses.
    """

    def __init__(self, path: Path) -> None:
        self.faults: tuple[str, ...] = ()
        with _room_named(path), damage_named(path):
            files = self._unpacked(path)
            for file in files:
                if not file.exists():
                    raise Damaged(f"{file.name} is missing")
            conditions = {storage_for(file).condition_of(file) for file in files}
        self.is_unfinished = Condition.UNFINISHED in conditions or (path.is_dir() and read_metadata(path) is None)
        if conditions - {Condition.COMPLETE}:
            target = self._folder() / "bag"
            with _room_named(path):
                self.faults = _write_complete(path, files, target, []).faults
            files = data_files(target)
        with damage_named(path):
            if self.faults and not self.is_unfinished:
                raise Damaged("; ".join(self.faults[:NAMED]))
            self.files: list[StoredFile] = [storage_for(file).FILE(file) for file in files]

    def _unpacked(self, path: Path) -> list[Path]:
        files = data_files(path)
        return _unpack(files, self._folder()) if any(file.suffix == PACKED for file in files) else files

    def _folder(self) -> Path:
        """Return a new temporary folder that is removed with this object, or at the end of the process."""
        stack = ExitStack()
        finalize(self, stack.close)
        return stack.enter_context(unfinished(temporary_place()))


def readable(path: Path) -> ReadableBag:
    """Return a bag as it can be opened; it is unpacked and checked once for as long as its files stay as they are.

    Raises
    ------
    InputError
        When it is no bag, damaged, or nothing in it is complete.
    """
    require_regular(path)
    parts = path.iterdir() if path.is_dir() else path.parent.glob(f"{escape(path.name)}*")
    states = [(part.name, part.stat()) for part in parts if part.is_file()]
    return _readable(path, tuple(sorted((name, state.st_size, state.st_mtime_ns) for name, state in states)))


@lru_cache(maxsize=2)
def _readable(path: Path, state: tuple[tuple[str, int, int], ...]) -> ReadableBag:
    return ReadableBag(path)


@contextmanager
def _room_named(path: Path) -> Iterator[None]:
    """Turn a disk without room for the temporary files of a bag into a sentence."""
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


def _unpack(files: list[Path], folder: Path, faults: list[str] | None = None) -> list[Path]:
    """Return the files of a bag, packed ones unpacked into a folder; where faults are listed as far as they go."""
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


def recover(path: Path, target: Path) -> Recovered:
    """Write a bag of all messages of another that are complete, in the order in which they were written.

    Parameters
    ----------
    path : Path
        The bag, which may be unfinished or damaged, and is not changed.
    target : Path
        The bag to write: a folder of the same storage, or a single file where its storage has single files.

    Raises
    ------
    InputError
        When it is no bag, no message of it is complete, or the new one cannot be written.
    """
    require_regular(path)
    faults: list[str] = []
    with unfinished(temporary_place()) as folder:
        with _room_named(path):
            files = _unpack(data_files(path), folder, faults)
        return _write_complete(path, files, target, faults)


def _write_complete(path: Path, files: list[Path], target: Path, faults: list[str]) -> Recovered:
    """Write the complete messages of the files of a bag, which may have been unpacked, to a new one."""
    from tam_calibration.recordings.bag_writing import write_bag

    faults.extend(f"{file.name} is missing" for file in files if not file.exists())
    count, first_ns, last_ns = 0, sys.maxsize, 0
    with write_bag(target, storage_of(path)) as writer:
        for block in _complete_blocks(path, [file for file in files if file.exists()], writer, faults):
            writer.write_block(block)
            count += len(block)
            first_ns = min(first_ns, int(block.recorded_ns.min()))
            last_ns = max(last_ns, int(block.recorded_ns.max()))
        if not count:
            raise InputError(f"{path} is damaged or truncated: no message in it is complete")
    return Recovered(count, first_ns, last_ns, tuple(faults))


def _complete_blocks(path: Path, files: list[Path], writer: "BlockWriter", faults: list[str]) -> Iterator[RawMessages]:
    """Yield the complete messages of files, their connections made known to a writer."""
    from tam_calibration.recordings.bag_writing import copy_connection

    copies: dict[tuple[str, str, str], int] = {}
    left_out: Counter[str] = Counter()
    others: Counter[str] = Counter()

    def usable(file: Path) -> Iterator[tuple[int, int, bytes]]:
        for one, recorded_ns, content in storage_for(file).complete_messages(file, faults):
            kind = one.topic, one.msgtype, serialisation_of(one)
            if not content:
                left_out[f"empty messages of {one.topic}"] += 1
            elif kind[2] not in READABLE:
                others[f"messages of {one.topic} in {kind[2]}"] += 1
            else:
                if kind not in copies:
                    copies[kind] = copy_connection(writer, one).id
                is_packed = content.startswith(ZSTD_BEGINNING)
                yield copies[kind], recorded_ns, unpack_bounded(content, "zstd", "a message") if is_packed else content

    with damage_named(path, may_recover=False):
        for file in files:
            yield from (block for block, _ in gather(usable(file)))
    faults.extend(f"{what}: {count} left out" for what, count in left_out.items())
    for what, count in others.items():
        log.warning("%s: %d %s are left out", path, count, what)
