"""Delimited text of any dialect, and tables of libraries, as rows: columns of numbers with a time each."""

import codecs
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tam_calibration.files.text_files import in_file, readable
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.libraries import require
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.channel_map import ChannelMap, TextFormat, TimeColumn
from tam_calibration.recordings.row_source import RowSource
from tam_calibration.recordings.tables import PIECE
from tam_calibration.recordings.text_dialect import MISSING, Dialect, cells_of, detect_dialect, is_number
from tam_calibration.recordings.times import stamps_of_words
from tam_calibration.recordings.vectors import is_own_column

if TYPE_CHECKING:
    import pandas
    import pyarrow


class TextSource(RowSource):
    """A delimited text file.

    Parameters
    ----------
    path : Path
        The file.
    text : TextFormat
        How it is written, as far as that is stated.
    time : TimeColumn
        Where its time is, as far as that is stated.
    """

    def __init__(self, path: Path, text: TextFormat, time: TimeColumn) -> None:
        self.dialect: Dialect = detect_dialect(path, text)
        names = self.dialect.names
        numeric = [name for column, name in enumerate(names) if self.dialect.is_numeric(column)]
        super().__init__(path, "text", names, numeric, time)

    def _is_time(self, column: str, is_numeric: bool) -> bool:
        cells = [row[self._columns.index(column)] for row in self.dialect.sample]
        if is_numeric:
            sign = self.dialect.decimal
            values = np.array([float(cell.replace(sign, ".")) for cell in cells if is_number(cell, sign)])
            return len(values) > 2 and bool((np.diff(values) >= 0).mean() > 0.98) and values[-1] > values[0]
        try:
            return bool(np.ptp(stamps_of_words(cells, "")))
        except InputError:
            return False

    def rows(self, fields: Sequence[str]) -> Iterator[tuple[Sequence[str] | FloatArray | None, FloatArray]]:
        """Yield the cells of the time and the numbers of some rows, so that a file may be larger than memory."""
        numbers = [self._columns.index(name) for name in fields]
        time = None if self.time_column is None else self._columns.index(self.time_column)
        is_numeric = time is not None and self.dialect.is_numeric(time) and not self.time_unit.startswith("%")
        wanted = [*numbers, time] if is_numeric and time is not None else numbers
        for number, lines in enumerate(self._pieces()):
            if not lines or lines.isspace():
                continue
            with in_file(self.path):
                try:
                    values = parse(lines, self.dialect, wanted)
                except ValueError:
                    above = sum(part.count(b"\n") or part.count(b"\r") for part in islice(self._pieces(), number))
                    raise InputError(_fault(lines, self.dialect, wanted, self.dialect.first_line + above)) from None
                if time is None:
                    yield None, values
                elif is_numeric:
                    yield values[:, -1], values[:, :-1]
                else:
                    yield words_of(lines, self.dialect, time), values

    def _pieces(self) -> Iterator[bytes]:
        """Yield the lines of numbers, many at once, without the comments; those of UTF-16 in UTF-8."""
        comment, header = re.escape(self.dialect.comment.encode()), self.dialect.first_line - 1
        with readable(self.path), self.path.open("rb") as file:
            read = codecs.EncodedFile(file, "utf-8", "utf-16").read if self.dialect.encoding == "utf-16" else file.read
            rest = read(PIECE).removeprefix(codecs.BOM_UTF8)
            rest = re.split(rb"\r\n?|\n", rest, maxsplit=header)[-1] if header else rest
            while rest:
                end = rest.rfind(b"\n") + 1 or rest.rfind(b"\r", 0, -1) + 1 or len(rest)
                lines, rest = rest[:end], rest[end:] + read(PIECE)
                if comment:
                    lines = re.sub(rb"(?:\A|(?<=[\r\n]))[ \t]*" + comment + rb"[^\r\n]*", b"", lines)
                yield lines


class FrameSource(RowSource):
    """A table of pandas: of a Parquet file, or in memory.

    Parameters
    ----------
    path : Path
        Where it came from.
    frame : pandas.DataFrame
        Its index counts as a column where it has a name.
    time : TimeColumn
        Where its time is, as far as that is stated.
    """

    def __init__(self, path: Path, frame: "pandas.DataFrame", time: TimeColumn) -> None:
        frame = frame.reset_index() if frame.index.name is not None or frame.index.dtype.kind in "Mm" else frame
        names = [str(name) for name in frame.columns]
        self._frame = frame.set_axis(names, axis=1)
        if len(set(names)) < len(names):
            raise InputError(f"{path}: a column is there twice")
        self._kinds = {name: getattr(self._frame[name].dtype, "kind", "O") for name in names}
        numeric = [name for name in names if self._kinds[name] in "iuf" or is_own_column(name)]
        moments = [name for name in names if self._kinds[name] in "Mm"]
        if moments and time == TimeColumn():
            time = TimeColumn(column=moments[0])
        super().__init__(path, "table", names, numeric, time)

    def rows(self, fields: Sequence[str]) -> Iterator[tuple[Sequence[str] | FloatArray | None, FloatArray]]:
        """Yield the times and the numbers of all rows."""
        try:
            values = self._frame[list(fields)].to_numpy(dtype=float, na_value=np.nan)
        except (TypeError, ValueError) as problem:
            raise InputError(f"the table contains what is not a number: {problem}") from None
        cells: Any = None
        if self.time_column is not None:
            column, kind = self._frame[self.time_column], self._kinds[self.time_column]
            if kind in "Mm":
                column = column.dt.tz_convert(None) if getattr(column.dtype, "tz", None) is not None else column
                cells = column.to_numpy().astype(f"{'datetime' if kind == 'M' else 'timedelta'}64[ns]").astype(np.int64)
            elif kind in "iuf":
                cells = column.to_numpy(dtype=float, na_value=np.nan)
            else:
                cells = [str(cell) for cell in column]
        yield cells, values


class TextReader:
    """Opens delimited text: the reader of whatever no other recognises."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether it is a file; whether it is text shows when it is opened."""
        return path.is_file()

    @contextmanager
    def open(self, path: Path, channel_map: ChannelMap | None) -> Iterator[TextSource]:
        """Open a text file."""
        text = TextFormat() if channel_map is None else channel_map.text
        time = TimeColumn() if channel_map is None else channel_map.time_column
        yield TextSource(path, text, time)


class ParquetReader:
    """Opens Parquet files."""

    def recognises(self, path: Path, beginning: bytes) -> bool:
        """Return whether a file begins as Parquet does."""
        return beginning.startswith(b"PAR1")

    @contextmanager
    def open(self, path: Path, channel_map: ChannelMap | None) -> Iterator[FrameSource]:
        """Open a Parquet file.

        Raises
        ------
        InputError
            When it is damaged.
        """
        require("tables", "reading Parquet files")
        import pandas
        import pyarrow

        try:
            frame = pandas.read_parquet(path)
        except (OSError, ValueError, pyarrow.ArrowException) as problem:
            raise InputError(f"{path} is damaged or no Parquet file: {' '.join(str(problem).split())[:200]}") from None
        yield FrameSource(path, frame, TimeColumn() if channel_map is None else channel_map.time_column)


_LARGE = 1 << 21
"""Bytes from which pyarrow, which takes a quarter of a second to load and is ten times as fast, is worth it."""


def parse(piece: bytes, dialect: Dialect, columns: Sequence[int]) -> FloatArray:
    """Return the (n, columns) numbers of lines; NaN where a cell has none.

    Raises
    ------
    ValueError
        When a line is no line of the table.
    """
    if not columns:
        return np.empty((sum(bool(line.strip()) for line in _lines_of(piece)), 0))
    table = _by_arrow(piece, dialect, columns) if len(piece) > _LARGE and dialect.delimiter != " " else None
    return _by_numpy(_lines_of(piece), dialect, columns) if table is None else table


def _lines_of(piece: bytes) -> list[str]:
    return re.split(r"\r\n?|\n", piece.decode(errors="replace").rstrip("\r\n"))


def _by_arrow(piece: bytes, dialect: Dialect, columns: Sequence[int]) -> FloatArray | None:
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
            pyarrow.py_buffer(piece),
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
    return np.array([_values_of(table[name].combine_chunks()) for name in chosen]).T


def _values_of(column: "pyarrow.DoubleArray") -> FloatArray:
    """Return the values (n,) of a column, NaN of blanks, without pandas, which ``to_numpy`` loads for half a second."""
    values: FloatArray = np.frombuffer(column.buffers()[1])[: len(column)]
    return np.where(np.from_dlpack(column.is_null().cast("uint8")), np.nan, values) if column.null_count else values


def _by_numpy(lines: Sequence[str], dialect: Dialect, columns: Sequence[int]) -> FloatArray:
    lines = [line for line in lines if line.strip()]
    cut = None if dialect.delimiter == " " else dialect.delimiter
    if any('"' in line for line in lines):
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


def words_of(piece: bytes, dialect: Dialect, column: int) -> list[str]:
    """Return the cells of a column."""
    lines = [line for line in _lines_of(piece) if line.strip()]
    if dialect.delimiter != " " and b'"' not in piece:
        return [line.split(dialect.delimiter, column + 1)[column].strip() for line in lines]
    return [cells_of(line, dialect.delimiter)[column].strip() for line in lines]


def _fault(piece: bytes, dialect: Dialect, columns: Sequence[int], first_line: int) -> str:
    """Return what is wrong with the first line that is no line of the table."""
    lines = _lines_of(piece)
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
