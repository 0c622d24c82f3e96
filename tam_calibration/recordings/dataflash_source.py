"""Logs of ArduPilot (DataFlash), read by the definitions that they hold.

pymavlink reads the same numbers, which the tests compare; but 100 MB take it a minute, and some damage for ever.

`MagX`, `MagY`, `MagZ` are readings to which ArduPilot has added its own offsets, `OfsX` and so on. A calibration that
is to replace those needs the readings without them: `RawX`, `RawY`, `RawZ`, which are added here and preferred.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from mmap import mmap
from pathlib import Path
from struct import Struct
from typing import NamedTuple

import numpy as np

from tam_calibration.recordings import tables
from tam_calibration.recordings.channel_map import ChannelMap
from tam_calibration.recordings.tables import MemorySource, Table, records_of, stored
from tam_calibration.recordings.times import PER_SECOND

_HEAD = b"\xa3\x95"
_HEAD_SIZE = Struct("<2sB").size
"""Bytes before the content of a message: two that are always the same, and its type."""

_FORMAT = 0x80
"""Type of the messages that define others."""

_DEFINITION = Struct("<BB4s16s64s")
_KINDS = {
    **{"b": "<i1", "B": "<u1", "M": "<u1", "h": "<i2", "H": "<u2", "i": "<i4", "I": "<u4", "q": "<i8", "Q": "<u8"},
    **{"g": "<f2", "f": "<f4", "d": "<f8", "n": "<S4", "N": "<S16", "Z": "<S64", "a": "<S64"},
    **{"c": "<i2", "C": "<u2", "e": "<i4", "E": "<u4", "L": "<i4"},
}
_DIVISORS = {**dict.fromkeys("cCeE", 100.0), "L": 1e7}
"""Of numbers that are stored as hundredths, and of degrees of latitude and longitude."""

_CLOCKS = {"TimeUS": "us", "TimeMS": "ms"}
"""Fields of the time, and their units."""
_DESCRIBING = ("FMT", "FMTU", "MULT", "PARM", "UNIT")
"""Messages that hold no readings."""


class _Format(NamedTuple):
    """Messages of one type: their name, length and numbers."""

    name: str
    length: int
    layout: tables.Layout

    @classmethod
    def of(cls, name: bytes, length: int, letters: bytes, columns: bytes) -> "_Format":
        """Return what a message defines; without numbers where its parts contradict each other."""
        names, offset, layout = _text(columns).split(","), _HEAD_SIZE, dict[str, tables.Field]()
        for column, letter in zip(names, _text(letters), strict=False):
            kind = _KINDS.get(letter, "<S0")
            layout[column] = tables.Field(offset - _HEAD_SIZE, kind, _DIVISORS.get(letter, 1.0))
            offset += int(kind[2:])
        is_complete = offset == length and len(layout) == len(names) == len(_text(letters))
        return cls(_text(name), length, layout if is_complete else {})


def _text(content: bytes) -> str:
    return content.partition(b"\0")[0].decode(errors="replace")


class _Log:
    """The messages of a log by their types, and how many bytes are of none."""

    def __init__(self, data: mmap) -> None:
        self._data, heads = data, tables.heads_in(data, _HEAD)
        kinds = np.frombuffer(data, np.uint8)[heads + len(_HEAD)]
        self._formats = {_FORMAT: _Format("FMT", _HEAD_SIZE + _DEFINITION.size, {})}
        for place in heads[kinds == _FORMAT].tolist():
            if place + self._formats[_FORMAT].length <= len(data):
                self._define(place + _HEAD_SIZE)
        lengths = np.zeros(256, dtype=np.int64)
        lengths[list(self._formats)] = [each.length for each in self._formats.values()]
        is_known = (lengths[kinds] > 0) & (heads + lengths[kinds] <= len(data))
        heads, kinds = heads[is_known], kinds[is_known]
        is_message = tables.following(heads, heads + lengths[kinds])
        heads, kinds = heads[is_message], kinds[is_message]
        self.lost = len(data) - int(lengths[kinds].sum())
        self._places = {kind: heads[kinds == kind] + _HEAD_SIZE for kind in self._formats}

    def _define(self, place: int) -> None:
        kind, length, name, letters, columns = _DEFINITION.unpack_from(self._data, place)
        if length >= _HEAD_SIZE and _text(name) not in {each.name for each in self._formats.values()}:
            self._formats.setdefault(kind, _Format.of(name, length, letters, columns))

    def _instances(self) -> dict[int, str]:
        """Return for each type of which the log says so the number that tells one sensor from another."""
        unit_kind = next((kind for kind, each in self._formats.items() if each.name == "FMTU"), _FORMAT)
        fields, places = self._formats[unit_kind].layout, self._places[unit_kind]
        if not {"FmtType", "UnitIds"} <= set(fields):
            return {}
        described = stored(self._data, places, fields)
        return {
            kind: list(self._formats[kind].layout)[place]
            for kind, letters in zip(described["FmtType"].tolist(), described["UnitIds"].tolist(), strict=True)
            if kind in self._formats and 0 <= (place := letters.find(b"#")) < len(self._formats[kind].layout)
        }

    def tables(self) -> Iterator[tables.Records]:
        """Yield the messages that have a time, those of each sensor on their own."""
        instances = self._instances()
        for kind, (name, _, layout) in self._formats.items():
            places = self._places[kind]
            time = next((each for each in _CLOCKS if each in layout and layout[each].kind[1] == "u"), "")
            if not time or not len(places) or name in _DESCRIBING:
                continue
            number = instances.get(kind, "")
            is_numbered = number in layout and layout[number].kind == "<u1"
            numbers = stored(self._data, places, {number: layout[number]})[number] if is_numbered else 0 * places
            fields = {each: field for each, field in _with_raw(layout).items() if each != number}
            for instance in np.unique(numbers).tolist():
                # Milligauss by ArduPilot's definition of its messages.
                units = {f"{kind}{axis}": "mG" for kind in ("Mag", "Ofs", "Raw") for axis in "XYZ" if "RawX" in fields}
                table = Table(name, (), instance=instance, units=units)
                tick_ns = PER_SECOND["ns"] // PER_SECOND[_CLOCKS[time]]
                yield records_of(table, self._data, places[numbers == instance], fields, time, tick_ns)


def _with_raw(layout: tables.Layout) -> tables.Layout:
    """Return the numbers of a magnetometer with the readings to which no offset was added; others as they are."""
    if not {f"{name}{axis}" for name in ("Mag", "Ofs") for axis in "XYZ"} <= set(layout):
        return layout
    return {**layout, **{f"Raw{axis}": layout[f"Mag{axis}"]._replace(less=f"Ofs{axis}") for axis in "XYZ"}}


class DataFlashReader:
    """Opens the logs of ArduPilot."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether a file begins with a message that defines others."""
        return beginning.startswith(_HEAD + bytes([_FORMAT]))

    @contextmanager
    def open(self, path: Path, channel_map: ChannelMap | None) -> Iterator[MemorySource]:
        """Open a log; the map tells nothing of how it is read.

        Raises
        ------
        InputError
            When it contains no readings.
        """
        log = _Log(tables.mapped(path))
        yield tables.log_source(path, "ArduPilot log", list(log.tables()), log.lost)
