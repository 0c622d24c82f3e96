"""The samples of a run on disk, so that a calibrator that is started anew goes on.

The first line of a file says what its samples are of, and of which node. Rows of one size follow, each with a checksum
over that line and itself: damage costs the rows that it hits, and no row is taken for one of another array or node.
"""

import json
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from tam_calibration.files.text_files import to_json, write_whole
from tam_calibration.messages.sample_store import StoredSample
from tam_calibration.model.exceptions import InputError
from tam_calibration.results.overwriting import name_aside

_BEGIN = b"tam samples"
"""What files begin with."""


_NUMBERS, _CHECK = [(name, "<i8") for name in StoredSample._fields[:3]], 4
"""What precedes the values of a row, and how many bytes of checksum follow them."""


class SampleFile:
    """Samples on disk.

    Parameters
    ----------
    path : Path
        Of the file; it and its folder are made when samples are saved.
    node : str
        Whose the file is. One of another node is left alone: this node has its own next to it.
    about : mapping
        What the samples are of, as JSON has it, such as the array.
    columns : int
        Numbers of a sample.

    Attributes
    ----------
    path : Path
        Of the file that the node has.
    remark : str
        What was wrong with the file that was there, as a sentence; empty where nothing was.
    """

    def __init__(self, path: Path, node: str, about: Mapping[str, Any], columns: int) -> None:
        self.path, self.remark = path, ""
        self._node = node
        text = json.dumps(json.loads(to_json({"node": node, **about}))).encode()
        self._check = crc32(text)
        self._head = b"%s %08x %s\n" % (_BEGIN, self._check, text)
        self._row = np.dtype([*_NUMBERS, ("row", "<f8", (columns,)), ("check", "<u4")])
        self._size = self._row.itemsize

    def read(self) -> tuple[list[StoredSample], bool]:
        """Return the complete samples in the order of their numbers, and whether the file can be gone on with.

        One that cannot is set aside: renamed, not changed.

        Raises
        ------
        InputError
            When the file cannot be read or renamed.
        """
        try:
            content = self._content()
            if _owner(content) not in (None, self._node):
                other, self.path = self.path, self.path.with_name(f"{self.path.name}.{self._node.replace('/', '.')}")
                self.remark = f"{other} is of another node: this one has {self.path}"
                return self.read()
            found = self._whole(content[len(self._head) :])
            is_complete = (
                content.startswith(self._head) and len(found) == (len(content) - len(self._head)) // self._size
            )
            if content and not is_complete:
                self._set_aside(content, found)
        except OSError as problem:
            raise self._cannot(problem) from problem
        return found, is_complete

    def _content(self) -> bytes:
        if not self.path.exists():
            return b""
        if not self.path.is_file():
            raise OSError("it is no regular file")
        with self.path.open("rb") as file:
            head = file.read(len(self._head))
            # Of a file that begins otherwise 256 MiB are searched, six times the usual size.
            return head + file.read(-1 if head == self._head else 1 << 28)

    def _set_aside(self, content: bytes, found: list[StoredSample]) -> None:
        why = "is damaged" if found or content.startswith(self._head) else "held no samples of this array"
        aside = self.path.rename(name_aside(self.path))
        used = f", and {len(found)} samples of it are used" if found else ""
        self.remark = f"{self.path} {why}: it is now {aside}{used}"

    def _whole(self, content: bytes) -> list[StoredSample]:
        rows = np.frombuffer(content[: len(content) // self._size * self._size], self._row)
        rows = rows[rows["check"] == self._checks(content, len(rows))]
        numbers = (rows[name].tolist() for name in StoredSample._fields[:3])
        return list(map(StoredSample, *numbers, map(np.copy, rows["row"])))

    def _checks(self, content: bytes, count: int) -> list[int]:
        starts = range(0, count * self._size, self._size)
        return [crc32(content[start : start + self._size - _CHECK], self._check) for start in starts]

    def save(self, samples: Sequence[StoredSample], kept: int) -> None:
        """Save samples.

        Parameters
        ----------
        samples : sequence of StoredSample
            All that shall be in the file.
        kept : int
            How many of them are there; 0 where others are.

        Raises
        ------
        InputError
            When the file cannot be written; what was there can still be read.
        """
        try:
            if kept and self._is_own():
                self._append(self._packed(samples[kept:]), len(self._head) + kept * self._size)
                return
            self.path.parent.mkdir(parents=True, exist_ok=True)
            if self.path.is_file() and not self._is_own():
                self.path.rename(name_aside(self.path))
            with write_whole(self.path) as temporary:
                temporary.write_bytes(self._head + self._packed(samples))
        except (OSError, InputError) as problem:
            raise self._cannot(problem) from problem

    def _append(self, rows: bytes, place: int) -> None:
        descriptor = os.open(self.path, os.O_WRONLY)
        try:
            while rows:
                written = os.pwrite(descriptor, rows, place)
                rows, place = rows[written:], place + written
        finally:
            os.close(descriptor)

    def _is_own(self) -> bool:
        """Return whether the file is there, and begins as this one does."""
        if not self.path.is_file():
            return False
        with self.path.open("rb") as file:
            return file.read(len(self._head)) == self._head

    def _packed(self, samples: Sequence[StoredSample]) -> bytes:
        rows = np.zeros(len(samples), self._row)
        for name, values in zip(StoredSample._fields, zip(*samples, strict=True), strict=False):
            rows[name] = values
        rows["check"] = self._checks(rows.tobytes(), len(rows))
        return rows.tobytes()

    def _cannot(self, problem: Exception) -> InputError:
        why = getattr(problem, "strerror", None) or problem
        return InputError(f"samples cannot be kept in {self.path}: {why}; name another samples_file, or none")


def _owner(content: bytes) -> str | None:
    """Return the node whose file begins so; None where that is damaged, or no such file."""
    with suppress(ValueError, LookupError):
        begin, check, text = content.partition(b"\n")[0].removeprefix(_BEGIN).split(b" ", 2)
        if not begin and int(check, 16) == crc32(text):
            return str(json.loads(text)["node"])
    return None
