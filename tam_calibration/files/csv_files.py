"""CSV: tables of numbers, recordings (time_s, b1x_nT … bKz_nT and the channels that there are), and corrected data."""

import re
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

import numpy as np

from tam_calibration.correction.calibration import Corrected
from tam_calibration.files.text_files import in_file, nanotesla_to_write, require_regular, write_whole
from tam_calibration.messages.point_cloud import CHANNEL_COLUMNS, SampleLayout
from tam_calibration.model.array import OUTPUT_NAMES
from tam_calibration.model.exceptions import InputError, quoted
from tam_calibration.model.further_channels import is_further, require_further
from tam_calibration.model.recording import BLOCK, Recording, require_sensor_count
from tam_calibration.model.units import NANOTESLA_PER_TESLA, TESLA_PER_FIELD_UNIT, FloatArray, from_nanotesla

_EMPTY_CELL = re.compile(r"(?<=,)[ \t]*(?=,|\r?$)|^[ \t]*(?=,)", re.MULTILINE)

_PIECE_CHARACTERS = 1 << 24

_LONGEST_LINE = 1 << 16
"""Characters: a line of a hundred sensors has some six thousand."""


def _read_table(path: Path) -> tuple[list[str], FloatArray]:
    """Return the column names and the (N, columns) numbers; an empty cell is NaN.

    Raises
    ------
    InputError
        When the file cannot be read, has no rows or a cell that is not a number.
    """
    pieces = list(_read_table_pieces(path))
    names, first = pieces[0]
    return names, first if len(pieces) == 1 else np.concatenate([table for _, table in pieces])


def _read_table_pieces(path: Path) -> Iterator[tuple[list[str], FloatArray]]:
    """Yield the column names with some rows after the other, so that a file may be larger than memory.

    Raises
    ------
    InputError
        As `_read_table` does, when the fault is met.
    """
    with _opened(path) as file:
        header, first_line, is_empty = _line(path, file, 1), 2, True
        if not header.strip():
            raise InputError(f"{path} is empty, or its first line is")
        if "\0" in header:
            raise InputError(f"{path} is not a text file")
        if ";" in header:
            raise InputError(f"{path} separates its columns by semicolons: use commas, and points within numbers")
        names = [name.strip() for name in header.split(",")]
        while lines := _lines(path, file, first_line):
            table = _numbers(lines, len(names))
            if table is None:
                raise InputError(_describe_fault(path, names, lines, first_line, is_end=not file.read(1)))
            if len(table):
                is_empty = False
                yield names, table
            first_line += len(lines)
        if is_empty:
            raise InputError(f"{path} holds a header but no sample")


def _lines(path: Path, file: TextIO, first_line: int) -> list[str]:
    """Return some more lines without their ends; none at the end of the file."""
    piece = file.read(_PIECE_CHARACTERS)
    lines = (piece + _line(path, file, first_line + piece.count("\n"))).split("\n")
    return lines if lines[-1] else lines[:-1]


def _line(path: Path, file: TextIO, number: int) -> str:
    """Return the rest of a line, with its end."""
    line = file.readline(_LONGEST_LINE)
    if len(line) == _LONGEST_LINE and not line.endswith("\n"):
        raise InputError(
            f"{path} is not a text file"
            if "\0" in line
            else f"{path} line {number} is longer than {_LONGEST_LINE} characters: is it a recording?"
        )
    return line


@contextmanager
def _opened(path: Path) -> Iterator[TextIO]:
    require_regular(path)
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
                _EMPTY_CELL.sub("nan", "\n".join(lines)).splitlines(), delimiter=",", ndmin=2, comments=None
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
                return f"{path} line {number} column {quoted(name)[1:-1]}: {quoted(cell.strip())} is not a number"
    return f"{path} is not a table of numbers separated by commas"


def _write_blocks(path: Path, names: Sequence[str], blocks: Iterable[FloatArray]) -> None:
    """Write a table of blocks of rows, with the shortest decimals that read back as the same numbers."""
    with write_whole(path) as beside, beside.open("w", encoding="utf-8", newline="\n") as file:
        file.write(",".join(names) + "\n")
        for rows in blocks:
            file.writelines(",".join(map(repr, row)) + "\n" for row in np.asarray(rows, dtype=float).tolist())


_STRONGEST_READING_T = 1.0
"""Of the strongest field that arrays are turned in, 10 mT, a hundred times: so large may a bias be."""

_SHORTEST_STEP_S = 1e-6
"""From sample to sample in the mean: no array reads a million times a second."""

_FIELD_COLUMN = re.compile(rf"(b([1-9]\d{{,8}})[xyz]|scalar)_({'|'.join(TESLA_PER_FIELD_UNIT)})")
_FURTHER = "[,current_2_A,…][,actuator_NAME,…]"
_EXPECTED = f"time_s,b1x_nT,b1y_nT,b1z_nT,…[,scalar_nT][,temperature_C][,current_A][,qx,qy,qz,qw]{_FURTHER}"


def read_csv_recording(path: Path) -> Recording:
    """Read a recording; fields may be given in nT, uT, G or T.

    Raises
    ------
    InputError
        When the file is no such table, or the numbers are no recording.
    """
    names, table = _read_table(path)
    with in_file(path):
        return _recording(names, table)


def read_csv_pieces(path: Path) -> Iterator[Recording]:
    """Yield what `read_csv_recording` returns in pieces of some ten thousand samples.

    A channel without a value in a whole piece is None in that piece.

    Raises
    ------
    InputError
        As `read_csv_recording` does, when the fault is met.
    """
    count = 0
    for names, table in _read_table_pieces(path):
        with in_file(f"{path}, samples from {count + 1}" if count else path):
            recording = _recording(names, table)
        count += len(table)
        yield recording


def _recording(names: list[str], table: FloatArray) -> Recording:
    columns = _standard_columns(names, table)
    layout = _layout(columns)
    recording = layout.recording(np.column_stack([columns[name] for name in layout.columns]))
    first_s, last_s = recording.time_span_s
    if last_s - first_s < _SHORTEST_STEP_S * (recording.sample_count - 1):
        raise InputError(f"{recording.sample_count} samples in {last_s - first_s:g} s: time_s must be in seconds")
    return recording


def write_csv_recording(path: Path, recording: Recording) -> None:
    """Write a recording with its fields in nT.

    Parameters
    ----------
    path : Path
        The CSV file; one that is there is replaced once the new one is whole.
    recording : Recording
        A channel that it lacks has no column; NaN is written as nan.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    layout = SampleLayout.of(recording)
    rows = layout.rows(recording)
    is_field = [name.endswith("_T") for name in layout.columns]
    blocks = (_block_to_write(rows[start : start + BLOCK], is_field) for start in range(0, len(rows), BLOCK))
    _write_blocks(path, [re.sub("_T$", "_nT", name) for name in layout.columns], blocks)


def _block_to_write(rows: FloatArray, is_field: list[bool]) -> FloatArray:
    rows[:, is_field] = nanotesla_to_write(rows[:, is_field])
    return rows


def _standard_columns(names: list[str], table: FloatArray) -> dict[str, FloatArray]:
    """Return the columns by their names in SI."""
    known = {"time_s", *(column for columns in CHANNEL_COLUMNS.values() for column in columns)}
    columns: dict[str, FloatArray] = {}
    for name, values in zip(names, table.T, strict=True):
        standard = name
        if match := _FIELD_COLUMN.fullmatch(name):
            standard, values = f"{match[1]}_T", _to_tesla(values, match[3])
            _require_field(name, values)
        elif name not in known and not is_further(name):
            raise InputError(f"column {quoted(name)} is not known: a recording has the columns {_EXPECTED}")
        if standard in columns:
            raise InputError(f"column {quoted(name)} is there twice")
        columns[standard] = values
    return columns


def _to_tesla(values: FloatArray, unit: str) -> FloatArray:
    # Divisions by whole numbers round decimals correctly; so microtesla and gauss go like nanotesla.
    with np.errstate(over="ignore"):  # what is infinite then is told as such
        whole = values * round(TESLA_PER_FIELD_UNIT[unit] * NANOTESLA_PER_TESLA)
    return values if unit == "T" else from_nanotesla(whole)


def _require_field(name: str, values_T: FloatArray) -> None:
    """Check that no value is beyond what a sensor reads, in a column whose others are not: those are of another unit.

    Raises
    ------
    InputError
        When one is.
    """
    sizes = np.abs(values_T)
    beyond = np.isfinite(sizes) & (sizes > _STRONGEST_READING_T)
    if 0 < beyond.sum() < len(sizes) / 2:
        raise InputError(
            f"column {name}: {beyond.sum()} of {len(sizes)} values are beyond {_STRONGEST_READING_T:g} T, first in "
            f"sample {beyond.argmax() + 1}: remove them"
        )


def _layout(columns: dict[str, FloatArray]) -> SampleLayout:
    sensors = [int(match[1]) for name in columns if (match := re.match(r"b(\d+)", name))]
    if not sensors:
        raise InputError(f"there is no sensor's column: a recording has the columns {_EXPECTED}")
    require_sensor_count(max(sensors))
    channels = [any(name in columns for name in group) for group in CHANNEL_COLUMNS.values()]
    layout = SampleLayout(max(sensors), *channels, further=require_further(filter(is_further, columns)))
    missing = [name for name in layout.columns if name not in columns]
    if missing:
        raise InputError(f"column {missing[0].replace('_T', '_nT')} is missing (of {max(sensors)} sensors)")
    return layout


_COLUMNS = ("time_s", *(f"{name}_nT" if name.startswith("b") else f"{name}_nT_per_m" for name in OUTPUT_NAMES))


def write_csv_corrected(path: Path, pieces: Iterable[Corrected]) -> None:
    """Write the centre vector in nT and the gradient tensor in nT/m, piece by piece; nan where there is no gradient.

    Parameters
    ----------
    path : Path
        The CSV file; one that is there is replaced once the new one is whole.
    pieces : iterable of Corrected
        Results in the order of time.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    blocks = (np.column_stack([piece.time_s, nanotesla_to_write(piece.outputs)]) for piece in pieces)
    _write_blocks(path, _COLUMNS, blocks)
