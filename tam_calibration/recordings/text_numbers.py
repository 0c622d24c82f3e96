"""The numbers and words in the lines of a text file."""

from collections.abc import Sequence
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np

from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.text_dialect import MISSING, Dialect, cells_of, is_number

if TYPE_CHECKING:
    import pyarrow

_LARGE = 1 << 21
"""Characters from which pyarrow, which takes a quarter of a second to load and is ten times as fast, is worth it."""


def parse(text: str, dialect: Dialect, columns: Sequence[int], first_line: int) -> FloatArray:
    """Return the (n, columns) numbers of lines; NaN where a cell has none.

    Raises
    ------
    InputError
        It names the first line that is no line of the table.
    """
    if not text.strip() or not columns:
        return np.empty((sum(bool(line.strip()) for line in text.split("\n")), len(columns)))
    try:
        table = _by_arrow(text, dialect, columns) if len(text) > _LARGE and dialect.delimiter != " " else None
        if table is None:
            table = _by_numpy(text, dialect, columns)
    except ValueError:
        raise InputError(_fault(text, dialect, columns, first_line)) from None
    return table


def _by_arrow(text: str, dialect: Dialect, columns: Sequence[int]) -> FloatArray | None:
    """Return the numbers of many lines; None where pyarrow is not installed, or cannot read them."""
    try:
        import pyarrow
        from pyarrow import csv
    except ModuleNotFoundError:
        return None
    names = [str(number) for number in range(len(dialect.names))]
    chosen = [names[column] for column in columns]
    try:
        table = csv.read_csv(
            BytesIO(text.encode()),
            csv.ReadOptions(column_names=names),
            csv.ParseOptions(delimiter=dialect.delimiter),
            csv.ConvertOptions(
                include_columns=chosen,
                column_types=dict.fromkeys(chosen, pyarrow.float64()),
                null_values=list(MISSING),
                decimal_point=dialect.decimal,
            ),
        )
    except pyarrow.ArrowException:
        return None
    return np.column_stack([_values_of(table[name].combine_chunks()) for name in chosen])


def _values_of(column: "pyarrow.DoubleArray") -> FloatArray:
    """Return the values (n,) of a column, NaN of blanks, without pandas, which ``to_numpy`` loads for half a second."""
    values: FloatArray = np.frombuffer(column.buffers()[1])[: len(column)]
    return np.where(np.from_dlpack(column.is_null().cast("uint8")), np.nan, values) if column.null_count else values


def _by_numpy(text: str, dialect: Dialect, columns: Sequence[int]) -> FloatArray:
    lines = [line for line in text.split("\n") if line.strip()]
    cut = None if dialect.delimiter == " " else dialect.delimiter
    if '"' in text:
        widths = (len(cells_of(line, dialect.delimiter)) for line in lines)
    else:
        widths = (len(line.split()) if cut is None else line.count(cut) + 1 for line in lines)
    if any(width != len(dialect.names) for width in widths):
        raise ValueError
    if dialect.decimal == ",":
        lines = [line.replace(",", ".") for line in lines]
    try:
        return np.loadtxt(lines, delimiter=cut, usecols=columns, ndmin=2, comments=None, quotechar='"')
    except ValueError:
        return np.array([_row(line, dialect.delimiter, columns) for line in lines])


def _row(line: str, delimiter: str, columns: Sequence[int]) -> list[float]:
    """Return some cells of a line as numbers, NaN where one has no value."""
    cells = cells_of(line, delimiter)
    chosen = [cells[column].strip() for column in columns]
    return [np.nan if cell in MISSING else float(cell) for cell in chosen]


def words_of(text: str, dialect: Dialect, column: int) -> list[str]:
    """Return the cells of a column."""
    lines = [line for line in text.split("\n") if line.strip()]
    if dialect.delimiter != " " and '"' not in text:
        return [line.split(dialect.delimiter, column + 1)[column].strip() for line in lines]
    return [cells_of(line, dialect.delimiter)[column].strip() for line in lines]


def _fault(text: str, dialect: Dialect, columns: Sequence[int], first_line: int) -> str:
    """Return what is wrong with the first line that is no line of the table."""
    lines = text.split("\n")
    for number, line in enumerate(lines, start=first_line):
        cells = cells_of(line, dialect.delimiter)
        if line.strip() and len(cells) != len(dialect.names):
            hint = ": the file seems to be truncated" if number == first_line + len(lines) - 1 else ""
            return f"line {number} has {len(cells)} values, but the table has {len(dialect.names)} columns{hint}"
        for column in columns if line.strip() else ():
            cell = cells[column].strip()
            if cell not in MISSING and not is_number(cell, dialect.decimal):
                return f"line {number} column {quoted(dialect.names[column])[1:-1]}: {quoted(cell)} is not a number"
    return "the lines are no table of numbers"
