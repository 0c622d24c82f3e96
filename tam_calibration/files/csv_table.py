"""Tables of numbers as text: a header of column names, then one line a row, separated by commas."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.files.whole import write_whole
from tam_calibration.units import FloatArray

_EMPTY_CELL = re.compile(r"(?<=,)[ \t]*(?=,|\r?$)|^[ \t]*(?=,)", re.MULTILINE)

_PIECE_CHARACTERS = 1 << 24


def read_table(path: Path) -> tuple[list[str], FloatArray]:
    """Return the column names and the (N, columns) numbers; an empty cell is NaN.

    Raises
    ------
    InputError
        When the file cannot be read, has no rows or a cell that is not a number.
    """
    pieces = list(read_table_pieces(path))
    names, first = pieces[0]
    return names, first if len(pieces) == 1 else np.concatenate([table for _, table in pieces])


def read_table_pieces(path: Path) -> Iterator[tuple[list[str], FloatArray]]:
    """Yield the column names with some rows after the other, so that a file may be larger than memory.

    Raises
    ------
    InputError
        As `read_table` does, when the fault is met.
    """
    with _opened(path) as file:
        header, first_line, is_empty = file.readline(), 2, True
        if not header.strip():
            raise InputError(f"{path} is empty, or its first line is")
        if "\0" in header:
            raise InputError(f"{path} is not a text file")
        if ";" in header:
            raise InputError(f"{path} separates its columns by semicolons: use commas, and points within numbers")
        names = [name.strip() for name in header.split(",")]
        while lines := file.readlines(_PIECE_CHARACTERS):
            table = _numbers(lines, len(names))
            if table is None:
                raise InputError(_describe_fault(path, names, lines, first_line, is_end=not file.read(1)))
            if len(table):
                is_empty = False
                yield names, table
            first_line += len(lines)
        if is_empty:
            raise InputError(f"{path} holds a header but no sample")


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            yield file
    except OSError as problem:
        raise InputError(f"{path} cannot be read: {problem.strerror}") from None
    except UnicodeDecodeError:
        raise InputError(f"{path} is not a text file") from None


def _numbers(lines: list[str], width: int) -> FloatArray | None:
    """Return the numbers of lines, or None where they are no table of that width."""
    if not any(line.strip() for line in lines):
        return np.empty((0, width))
    try:
        try:
            table = np.loadtxt(lines, delimiter=",", ndmin=2, comments=None)
        except ValueError:
            table = np.loadtxt(
                _EMPTY_CELL.sub("nan", "".join(lines)).splitlines(), delimiter=",", ndmin=2, comments=None
            )
    except ValueError:
        return None
    return table if table.shape[1] == width else None


def _describe_fault(path: Path, names: Sequence[str], lines: list[str], first_line: int, is_end: bool) -> str:
    for number, line in enumerate(lines, start=first_line):
        cells = line.split(",")
        if line.strip() and len(cells) != len(names):
            is_last = is_end and number == first_line + len(lines) - 1
            hint = ": the file seems to be truncated" if is_last else ""
            return f"{path} line {number} has {len(cells)} values, but the header has {len(names)} columns{hint}"
        for name, cell in zip(names, cells, strict=False):
            try:
                float(cell.strip() or "nan")
            except ValueError:
                return f"{path} line {number} column {name}: {cell.strip()!r} is not a number"
    return f"{path} is not a table of numbers separated by commas"


def write_table(path: Path, names: Sequence[str], rows: FloatArray) -> None:
    """Write a table with the shortest decimals that read back as the same numbers."""
    write_blocks(path, names, [rows])


def write_blocks(path: Path, names: Sequence[str], blocks: Iterable[FloatArray]) -> None:
    """Write a table as `write_table` does, from rows that come block by block."""
    with write_whole(path) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for rows in blocks:
            file.writelines(",".join(map(repr, row)) + "\n" for row in np.asarray(rows, dtype=float).tolist())
