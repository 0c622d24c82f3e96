"""Logs of PX4 (ULog), read by the definitions that they hold.

pyulog reads the same numbers, which the tests compare; but 100 MB take it ten seconds, and some damage an hour.
"""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from math import inf
from mmap import mmap
from pathlib import Path
from struct import Struct

import numpy as np

from tam_calibration.files.text_files import in_file
from tam_calibration.messages.message_fields import NUMBERS
from tam_calibration.model.exceptions import InputError
from tam_calibration.recordings import tables
from tam_calibration.recordings.channel_map import ChannelMap

_MAGIC = b"ULog\x01\x12\x35"
_HEAD, _SUBSCRIPTION, _FLAGS = Struct("<HB"), Struct("<BH"), Struct("<8s8s3Q")
_FILE_HEAD = Struct("<7sBQ").size
"""Bytes before the first message: mark, version and time."""

_FIRST = _FILE_HEAD + _HEAD.size
"""Where the content of the first message begins."""

_SYNC = b"\x08\x00S\x2f\x73\x13\x20\x25\x0c\xbb\x12"
"""The message that the logger writes now and then, from which a reader finds its way again."""

_LONGEST = 1 << 16
"""More bytes than a message contains."""

_DATA, _FORMAT, _ADDED, _FLAG_BITS = b"DFAB"
_OTHERS = frozenset(b"FABIMPQRLCSO")
"""Kinds of messages that hold no readings."""


_KINDS = {f"{name}_t": f"<{kind}" for name, kind in NUMBERS.items() if "int" in name}
_KINDS |= {"float": "<f4", "double": "<f8", "bool": "<u1", "char": "<S1"}
_TIMES: Sequence[str] = ("timestamp_sample", "timestamp")
_FIELD = re.compile(r"(\w+)(?:\[(\d{1,5})\])? (\w+)")


class _Formats(dict[str, list[tuple[str, int, str]]]):
    """Type, number and name of each field of each format; a number of 0 is no list."""

    def __init__(self) -> None:
        super().__init__()
        self._sizes: dict[str, float] = {name: int(kind[2:]) for name, kind in _KINDS.items()}

    def define(self, text: str) -> None:
        """Add a format; what follows the last field that can be read, or only pads the message, is left out."""
        name, _, rest = text.partition(":")
        matches = [_FIELD.fullmatch(each) for each in rest.split(";")[:-1]]
        if matches and None not in matches:
            self.setdefault(name, [(each[1], int(each[2] or 0), each[3]) for each in matches if each])

    def topic(self, name: str) -> list[tuple[str, int, str]]:
        """Return the fields of a topic's messages, without the padding at their end, which is not logged."""
        fields = self.get(name, [])
        while fields and fields[-1][2].startswith("_padding"):
            fields = fields[:-1]
        return fields

    def size(self, fields: list[tuple[str, int, str]]) -> float:
        """Return the bytes of some fields; infinite where a format is not known or contains itself."""
        return sum(max(count, 1) * self._size(kind) for kind, count, _ in fields)

    def _size(self, kind: str) -> float:
        if kind not in self._sizes:
            self._sizes[kind] = inf
            self._sizes[kind] = self.size(self[kind]) if kind in self else inf
        return self._sizes[kind]

    def numbers(self, fields: list[tuple[str, int, str]], before: str = "") -> Iterator[tuple[str, str]]:
        """Yield path and type of each number of some fields, whose size is finite."""
        for kind, count, name in fields:
            for path in [f"{before}{name}[{place}]" for place in range(count)] or [before + name]:
                if kind in _KINDS:
                    yield path, _KINDS[kind]
                else:
                    yield from self.numbers(self[kind], f"{path}.")

    def layout(self, name: str) -> dict[str, tables.Field]:
        """Return the numbers of a topic's messages by their paths, without those that pad."""
        layout, offset = {}, 0
        for path, kind in self.numbers(self.topic(name)):
            if "_padding" not in path:
                layout[path] = tables.Field(offset, kind)
            offset += int(kind[2:])
        return layout


class _Log:
    """The messages of a log: what they define, where those of each topic are, and how many bytes are of none."""

    def __init__(self, data: mmap) -> None:
        self._data, self._formats, self._window = data, _Formats(), _LONGEST
        self._topics: dict[tuple[str, int], int] = {}
        self._topic_of = np.zeros(1 << 16, dtype=np.int64)
        self._least, self._most = np.full((2, 1 << 16), _LONGEST)
        self._found = [(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64))]
        self.lost, place = 0, _FILE_HEAD
        for end in _ends(data):
            self._walk(place, end)
            place = end

    def _walk(self, place: int, end: int) -> None:
        """Go from message to message of a part that was written at once, after damage from the next mark on."""
        while place + _HEAD.size <= end:
            length, kind = _HEAD.unpack_from(self._data, place)
            content = place + _HEAD.size
            after = content + length
            if kind == _DATA and length >= 2 and after <= end:
                taken = self._take(place, after, end)
                self.lost += 0 if taken else after - place
                after = taken or after
            elif after > end or not self._defines(kind, self._data[content:after]):
                after = self._data.find(_SYNC, place + 1, end)
                if after < 0:
                    break
                self.lost += after - place
            place = after
        self.lost += end - place

    def _take(self, place: int, after: int, end: int) -> int:
        """Take the readings that follow each other from a place on; return where they end, 0 where there are none.

        They are found many at once: by their kind and topic, and as each begins where the one before ends.
        """
        size = min(max(self._window, after - place), end - place)
        piece = np.frombuffer(self._data, np.uint8, size, place)
        heads = np.flatnonzero(piece[2:-2] == _DATA)
        low, high, number_low, number_high = (piece[heads + byte].astype(np.int64) for byte in (0, 1, 3, 4))
        lengths, numbers = low + 256 * high, number_low + 256 * number_high
        ends = heads + _HEAD.size + lengths
        is_sound = (lengths >= self._least[numbers]) & (lengths <= self._most[numbers]) & (ends <= size)
        heads, ends, numbers = heads[is_sound], ends[is_sound], numbers[is_sound]
        if not len(heads) or heads[0] > 0:
            return 0
        breaks = np.flatnonzero(heads[1:] != ends[:-1])
        count = int(breaks[0]) + 1 if len(breaks) else len(heads)
        self._found.append((self._topic_of[numbers[:count]], heads[:count] + place + _HEAD.size + 2))
        taken = int(ends[count - 1])
        # The next readings are looked for in as many bytes as had some without a break before.
        self._window = min(2 * taken, _LONGEST)
        return place + taken

    def _defines(self, kind: int, content: bytes) -> bool:
        """Take a message that defines others; return whether it is known and has no readings."""
        if kind == _FORMAT:
            self._formats.define(content.decode(errors="replace"))
        elif kind == _ADDED and len(content) > _SUBSCRIPTION.size:
            instance, number = _SUBSCRIPTION.unpack_from(content)
            name = content[_SUBSCRIPTION.size :].decode(errors="replace")
            self._topic_of[number] = self._topics.setdefault((name, instance), len(self._topics))
            size = self._formats.size
            self._least[number] = min(size(self._formats.topic(name)) + 2, _LONGEST)
            self._most[number] = min(size(self._formats.get(name, [])) + 2, _LONGEST)
        return kind in _OTHERS

    def tables(self) -> Iterator[tables.Records]:
        """Yield the topics with a time: that of the readings, where all have one, else that of the messages."""
        topics, places = (np.concatenate(each) for each in zip(*self._found, strict=True))
        order = np.argsort(topics, kind="stable")
        own = np.split(places[order], np.searchsorted(topics[order], np.arange(1, len(self._topics))))
        for (name, instance), at in zip(self._topics, own, strict=False):
            layout = self._formats.layout(name) if len(at) else {}
            times = {name: layout.pop(name) for name in _TIMES if name in layout}
            if any(field.kind != "<u8" for field in times.values()) or not times:
                continue
            ticks = tables.stored(self._data, at, times)
            time = next((each for each in times if ticks[each].all()), list(times)[-1])
            # Gauss by PX4's definitions of its messages.
            is_mag = name == "sensor_mag"
            units = {path: "G" for path in layout if "_ga[" in path or (is_mag and path in ("x", "y", "z"))}
            table = tables.Table(name, (), instance=instance, units=units)
            yield tables.records_of(table, self._data, at, {**layout, time: times[time]}, time, 1000)


def _ends(data: mmap) -> list[int]:
    """Return where the parts of a log end: after a crash, what is appended follows a message that may be cut.

    Raises
    ------
    InputError
        When it is to be read otherwise.
    """
    length, kind = _HEAD.unpack_from(data, _FILE_HEAD) if len(data) >= _FIRST + _FLAGS.size else (0, 0)
    if kind != _FLAG_BITS or length < _FLAGS.size:
        return [len(data)]
    _, flags, *appended = _FLAGS.unpack_from(data, _FIRST)
    # The one incompatible flag that is known: data were appended after a crash.
    if flags not in (bytes(8), b"\x01".ljust(8, b"\0")):
        raise InputError("it is a ULog of a later kind, which has to be read otherwise")
    return [*sorted(each for each in set(appended) if _FIRST < each < len(data)), len(data)]


class UlogReader:
    """Opens the logs of PX4."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether a file begins as a ULog does."""
        return beginning.startswith(_MAGIC)

    @contextmanager
    def open(self, path: Path, channel_map: ChannelMap | None) -> Iterator[tables.MemorySource]:
        """Open a log; the map tells nothing of how it is read.

        Raises
        ------
        InputError
            When it contains no readings, or has to be read otherwise.
        """
        with in_file(path):
            try:
                log = _Log(tables.mapped(path))
                found = list(log.tables())
            except RecursionError:
                raise InputError("the definitions of its messages hold each other without end") from None
        yield tables.log_source(path, "PX4 log", found, log.lost)
