"""Bags made readable: unpacked, checked, and what a recorder left unfinished recovered."""

import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING
from weakref import finalize

from rosbags.interfaces import Connection

from tam_calibration.files.bag_bounds import ZSTD_BEGINNING, unpack_file, unpack_message
from tam_calibration.files.bag_damage import NAMED, NO_ROOM, damage_named
from tam_calibration.files.bag_digests import DIGESTS, are_complete, changed_files
from tam_calibration.files.bag_folder import INFORMATION, METADATA, PACKED, data_files, read_metadata
from tam_calibration.files.bag_storages import guard_of, storage_of
from tam_calibration.files.sqlite3_guard import LOGS
from tam_calibration.files.text_files import require_regular
from tam_calibration.files.whole_files import temporary_place, unfinished
from tam_calibration.files.yaml_document import dump_mapping
from tam_calibration.messages.cdr import RawMessages
from tam_calibration.model.exceptions import InputError

if TYPE_CHECKING:  # what writes bags takes a third of a second to load, and who reads a sound one needs none
    from tam_calibration.files.bag_writing import BlockWriter

_COUNT = 16_384
"""Messages that are written at once."""


@dataclass(frozen=True)
class Recovered:
    """What was whole in a bag.

    Parameters
    ----------
    messages : int
        How many messages.
    first_ns, last_ns : int
        When the first and the last of them were recorded, nanoseconds.
    faults : tuple of str
        What was left out, though something stands behind it.
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
        return f"{self.messages} whole messages are recovered, {ends}{''.join(f'; {each}' for each in lost)}"


class ReadableBag:
    """A bag as it can be opened.

    Attributes
    ----------
    path : Path
        The bag itself, or what stands for it in a temporary folder, which goes with this object.
    unfinished : str
        What was recovered of a bag that its recorder did not finish, as a clause; empty where it did.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.unfinished = path, ""
        with _room_named(path):
            self._make_readable(path)

    def _make_readable(self, path: Path) -> None:
        files = data_files(path)
        with damage_named(path):
            is_proven = path.is_dir() and _is_proven(path, files)
        if _is_packed(files):
            self.path = self._folder()
            files = _unpack(path, files, self.path)
        if is_proven:
            return
        present = [file for file in files if file.exists()]
        with damage_named(path):
            is_unfinished = any(guard_of(file).is_unfinished() for file in present)
        if is_unfinished or _is_without_metadata(path):
            target = self._folder() / "bag"
            self.unfinished = f"the recording was left unfinished: {_recover(path, files, target, [])}"
            self.path = target
            return
        with damage_named(path):
            for file in present:
                if damage := guard_of(file).find_damage():
                    raise InputError(f"{damage}; {_mend(path)}")

    def _folder(self) -> Path:
        """Return a new temporary folder that is removed with this object, or at the end of the process."""
        stack = ExitStack()
        finalize(self, stack.close)
        return stack.enter_context(unfinished(temporary_place()))


def readable(path: Path) -> ReadableBag:
    """Return a bag as it can be opened; what is looked at once stays so as long as its files do.

    Raises
    ------
    InputError
        When it is no bag, damaged, or nothing in it is whole.
    """
    require_regular(path)
    parts = path.iterdir() if path.is_dir() else [path, *(path.with_name(path.name + suffix) for suffix in LOGS)]
    states = [(part.name, part.stat()) for part in parts if part.is_file()]
    return _readable(path, tuple(sorted((name, state.st_size, state.st_mtime_ns) for name, state in states)))


@lru_cache(maxsize=2)
def _readable(path: Path, state: tuple[tuple[str, int, int], ...]) -> ReadableBag:
    return ReadableBag(path)


def _is_proven(path: Path, files: list[Path]) -> bool:
    """Return whether digests prove that all files of a folder are what was written.

    Raises
    ------
    InputError
        When they prove that one is not.
    """
    changed = changed_files(path)
    if changed:
        names = " and ".join(file.name for file in changed)
        faults = [guard_of(file).damaged_messages() for file in changed if file in files and file.suffix != PACKED]
        named = "".join(f"; {fault}" for fault in faults if fault)
        raise InputError(f"{names} changed since it was written, by {DIGESTS}{named}; {_mend(path)}")
    return changed is not None and are_complete(path)


def _mend(path: Path) -> str:
    return f"`tam recover {path} -o NEW` keeps what is whole"


def _is_without_metadata(path: Path) -> bool:
    return path.is_dir() and read_metadata(path) is None


@contextmanager
def _room_named(path: Path) -> Iterator[None]:
    """Have it told that there is no room for what is unpacked or recovered of a bag."""
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


def _is_packed(files: list[Path]) -> bool:
    """Return whether some of the files of a bag are packed as a whole."""
    return any(file.suffix == PACKED for file in files)


def _unpack(path: Path, files: list[Path], folder: Path, faults: list[str] | None = None) -> list[Path]:
    """Write a bag to a folder with its files unpacked, and return them; with a list of faults as far as they go."""
    targets = [folder / file.name.removesuffix(PACKED) for file in files]
    for file, target in zip(files, targets, strict=True):
        if file.suffix != PACKED:
            with suppress(FileNotFoundError):
                shutil.copyfile(file, target)
            continue
        try:
            with damage_named(path):
                unpack_file(file, target)
        except InputError:
            if faults is None or not target.exists():
                raise
            faults.append(f"{file.name} cannot be unpacked to its end")
    metadata = read_metadata(path)
    if metadata is not None:
        names = [target.name for target in targets]
        plain = metadata | {"relative_file_paths": names, "compression_mode": "", "compression_format": ""}
        (folder / METADATA).write_text(dump_mapping({INFORMATION: plain}), encoding="utf-8")
    return targets


def recover(path: Path, target: Path) -> Recovered:
    """Write a bag of all messages of another that are whole, in the order in which they were written.

    Parameters
    ----------
    path : Path
        The bag, which may be unfinished or damaged, and is not changed.
    target : Path
        The bag to write: a folder of the same storage, or a single file where its storage stands alone.

    Raises
    ------
    InputError
        When it is no bag, no message of it is whole, or the new one cannot be written.
    """
    require_regular(path)
    files = data_files(path)
    faults: list[str] = []
    with unfinished(temporary_place()) as folder:
        with _room_named(path):
            unpacked = _unpack(path, files, folder, faults) if _is_packed(files) else files
        return _recover(path, unpacked, target, faults)


def _recover(path: Path, files: list[Path], target: Path, faults: list[str]) -> Recovered:
    """Recover the bag of a path from its files, which may have been unpacked."""
    from tam_calibration.files.bag_writing import write_bag

    faults.extend(f"{file.name} is missing" for file in files if not file.exists())
    count, first_ns, last_ns = 0, sys.maxsize, 0
    with write_bag(target, storage_of(path)) as writer:
        for block in _whole_blocks(path, files, writer, faults):
            writer.write_block(block)
            count += len(block)
            first_ns = min(first_ns, int(block.recorded_ns.min()))
            last_ns = max(last_ns, int(block.recorded_ns.max()))
        if not count:
            raise InputError(f"{path} is damaged or truncated: no message in it is whole")
    return Recovered(count, first_ns, last_ns, tuple(faults))


def _whole_blocks(path: Path, files: list[Path], writer: "BlockWriter", faults: list[str]) -> Iterator[RawMessages]:
    """Yield the whole messages of files, their connections made known to a writer."""
    from tam_calibration.files.bag_writing import copy_connection

    copies: dict[tuple[str, str], int] = {}
    messages = chain.from_iterable(guard_of(file).whole_messages(faults) for file in files if file.exists())
    with damage_named(path):
        while some := list(islice(messages, _COUNT)):
            for connection, _, _ in some:
                if _name(connection) not in copies:
                    copies[_name(connection)] = copy_connection(writer, connection).id
            numbers = [copies[_name(connection)] for connection, _, _ in some]
            contents = [_unpacked(content) for _, _, content in some]
            yield RawMessages.of(numbers, [recorded_ns for _, recorded_ns, _ in some], contents)


def _name(connection: Connection) -> tuple[str, str]:
    return connection.topic, connection.msgtype


def _unpacked(content: bytes) -> bytes:
    """Return a message that may have been packed by itself."""
    return unpack_message(content) if content.startswith(ZSTD_BEGINNING) else content
