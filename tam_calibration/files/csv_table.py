"""Tables of numbers as text: a header of column names, then one line a row, separated by commas."""

import re
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from tam_calibration.files.location import read_text
from tam_calibration.files.whole import write_whole
from tam_calibration.problems import InputError
from tam_calibration.units import FloatArray

_EMPTY_CELL = re.compile(r"(?<=,)[ \t]*(?=,|\r?$)|^[ \t]*(?=,)", re.MULTILINE)


def read_table(path: Path) -> tuple[list[str], FloatArray]:
    """Return the column names and the (N, columns) numbers; an empty cell is NaN.

    Raises
    ------
    InputError
        When the file cannot be read, has no rows or a cell that is not a number.
    """
    header, _, body = read_text(path).partition("\n")
    if ";" in header:
        raise InputError(f"{path} separates its columns by semicolons: use commas, and points within numbers")
    names = [name.strip() for name in header.split(",")]
    if not body.strip():
        raise InputError(f"{path} holds a header but no sample")
    body = _EMPTY_CELL.sub("nan", body)
    try:
        table = np.loadtxt(body.splitlines(), delimiter=",", ndmin=2, comments=None)
    except ValueError:
        table = None
    if table is None or table.shape[1] != len(names):
        raise InputError(_describe_fault(path, names, body.splitlines()))
    return names, table


def _describe_fault(path: Path, names: Sequence[str], lines: list[str]) -> str:
    for number, line in enumerate(lines, start=2):
        cells = line.split(",")
        if line.strip() and len(cells) != len(names):
            hint = ": the file seems to be truncated" if number == len(lines) + 1 else ""
            return f"{path} line {number} has {len(cells)} values, but the header has {len(names)} columns{hint}"
        for name, cell in zip(names, cells, strict=False):
            try:
                float(cell or "nan")
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
