"""Recordings as CSV: time_s, b1x_nT … bKz_nT, and the channels that there are."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tam_calibration.exceptions import InputError
from tam_calibration.files.csv_table import read_table, read_table_pieces, write_table
from tam_calibration.files.exact import nanotesla_to_write
from tam_calibration.files.location import in_file
from tam_calibration.pointcloud_layout import CHANNEL_COLUMNS, SampleLayout
from tam_calibration.recording import Recording
from tam_calibration.units import NANOTESLA_PER_TESLA, TESLA_PER_FIELD_UNIT, FloatArray, from_nanotesla

_FIELD_COLUMN = re.compile(rf"(b([1-9]\d*)[xyz]|scalar)_({'|'.join(TESLA_PER_FIELD_UNIT)})")
_EXPECTED = "time_s,b1x_nT,b1y_nT,b1z_nT,…[,scalar_nT][,temperature_C][,current_A][,qx,qy,qz,qw]"


def read_csv_recording(path: Path) -> Recording:
    """Read a recording; fields may be given in nT, uT, G or T.

    Raises
    ------
    InputError
        When the file is no such table, or the numbers are no recording.
    """
    names, table = read_table(path)
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
    for names, table in read_table_pieces(path):
        with in_file(f"{path}, samples from {count + 1}" if count else path):
            recording = _recording(names, table)
        count += len(table)
        yield recording


def _recording(names: list[str], table: FloatArray) -> Recording:
    columns = _standard_columns(names, table)
    layout = _layout(columns)
    return layout.recording(np.column_stack([columns[name] for name in layout.columns]))


def write_csv_recording(path: Path, recording: Recording) -> None:
    """Write a recording with its fields in nT.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    layout = SampleLayout.of(recording)
    rows = layout.rows(recording)
    is_field = [name.endswith("_T") for name in layout.columns]
    rows[:, is_field] = nanotesla_to_write(rows[:, is_field])
    write_table(path, [re.sub("_T$", "_nT", name) for name in layout.columns], rows)


def _standard_columns(names: list[str], table: FloatArray) -> dict[str, FloatArray]:
    """Return the columns by their names in SI."""
    known = {"time_s", *(column for columns in CHANNEL_COLUMNS.values() for column in columns)}
    columns: dict[str, FloatArray] = {}
    for name, values in zip(names, table.T, strict=True):
        standard = name
        if match := _FIELD_COLUMN.fullmatch(name):
            standard, values = f"{match[1]}_T", _to_tesla(values, match[3])
        elif name not in known:
            raise InputError(f"column {name!r} is not known: a recording has the columns {_EXPECTED}")
        if standard in columns:
            raise InputError(f"column {name!r} is there twice")
        columns[standard] = values
    return columns


def _to_tesla(values: FloatArray, unit: str) -> FloatArray:
    # Divisions by whole numbers round decimals correctly; so microtesla and gauss go like nanotesla.
    return values if unit == "T" else from_nanotesla(values * round(TESLA_PER_FIELD_UNIT[unit] * NANOTESLA_PER_TESLA))


def _layout(columns: dict[str, FloatArray]) -> SampleLayout:
    sensors = [int(match[1]) for name in columns if (match := re.match(r"b(\d+)", name))]
    if not sensors:
        raise InputError(f"there is no sensor's column: a recording has the columns {_EXPECTED}")
    layout = SampleLayout(max(sensors), *(any(name in columns for name in group) for group in CHANNEL_COLUMNS.values()))
    missing = [name for name in layout.columns if name not in columns]
    if missing:
        raise InputError(f"column {missing[0].replace('_T', '_nT')} is missing (of {max(sensors)} sensors)")
    return layout
