"""Delimited text of any dialect, and tables of libraries, as rows: columns of numbers with a time each."""

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tam_calibration.files.text_files import in_file
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray
from tam_calibration.recordings.channel_map import ChannelMap, TextFormat, TimeColumn
from tam_calibration.recordings.own_names import is_own_column
from tam_calibration.recordings.row_source import RowSource
from tam_calibration.recordings.text_dialect import LONGEST_LINE, Dialect, detect_dialect, is_number
from tam_calibration.recordings.text_numbers import parse, words_of
from tam_calibration.recordings.times import stamps_of_words

if TYPE_CHECKING:
    import pandas

_PIECE = 1 << 24
"""Characters that are read at once."""


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
        super().__init__(path, "text", names, numeric, time, self.dialect.has_header)

    def _is_time(self, column: str, is_numeric: bool) -> bool:
        cells = [row[self._columns.index(column)] for row in self.dialect.sample]
        if is_numeric:
            sign = self.dialect.decimal
            values = np.array([float(cell.replace(sign, ".")) for cell in cells if is_number(cell, sign)])
            return len(values) > 2 and bool((np.diff(values) >= 0).mean() > 0.98) and values[-1] > values[0]
        try:
            stamps_of_words(cells, "")
        except InputError:
            return False
        return True

    def rows(self, fields: Sequence[str]) -> Iterator[tuple[Sequence[str] | FloatArray | None, FloatArray]]:
        """Yield the cells of the time and the numbers of some rows, so that a file may be larger than memory."""
        numbers = [self._columns.index(name) for name in fields]
        time = None if self.time_column is None else self._columns.index(self.time_column)
        is_numeric = time is not None and self.dialect.is_numeric(time) and not self.time_unit.startswith("%")
        wanted = [*numbers, time] if is_numeric and time is not None else numbers
        line = self.dialect.first_line
        for text in self._texts():
            with in_file(self.path):
                values = parse(text, self.dialect, wanted, line)
                if time is None:
                    yield None, values
                elif is_numeric:
                    yield values[:, -1], values[:, :-1]
                else:
                    yield words_of(text, self.dialect, time), values
            line += text.count("\n") + 1

    def _texts(self) -> Iterator[str]:
        """Yield the lines of numbers, many at once, without the comments."""
        comment = self.dialect.comment
        try:
            with self.path.open(encoding=self.dialect.encoding, newline=None) as file:
                for _ in range(self.dialect.first_line - 1):
                    file.readline(LONGEST_LINE)
                while text := file.read(_PIECE):
                    text += file.readline(LONGEST_LINE)
                    if comment and comment in text:
                        text = re.sub(rf"^[ \t]*{re.escape(comment)}.*$", "", text, flags=re.MULTILINE)
                    if text.strip():
                        yield text.removesuffix("\n")
        except OSError as problem:
            raise InputError(f"{self.path} cannot be read: {problem.strerror}") from None
        except UnicodeDecodeError:
            raise InputError(f"{self.path} is not a text file") from None


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
        kinds = {name: self._frame[name].dtype for name in names}
        numeric = [name for name in names if getattr(kinds[name], "kind", "O") in "iuf" or is_own_column(name)]
        moments = [name for name in names if getattr(kinds[name], "kind", "O") in "Mm"]
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
            column = self._frame[self.time_column]
            kind = getattr(column.dtype, "kind", "O")
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
        from tam_calibration.model.extras import require

        require("tables", "reading Parquet files")
        import pandas
        import pyarrow

        try:
            frame = pandas.read_parquet(path)
        except (OSError, ValueError, pyarrow.ArrowException) as problem:
            raise InputError(f"{path} is damaged or no Parquet file: {' '.join(str(problem).split())[:200]}") from None
        yield FrameSource(path, frame, TimeColumn() if channel_map is None else channel_map.time_column)
