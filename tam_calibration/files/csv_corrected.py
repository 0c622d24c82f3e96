"""Corrected data as CSV: time_s, bx_nT … gzz_nT_per_m."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tam_calibration.array import OUTPUT_NAMES
from tam_calibration.calibration import Corrected
from tam_calibration.files.csv_table import write_blocks
from tam_calibration.files.exact import nanotesla_to_write

COLUMNS = ("time_s", *(f"{name}_nT" if name.startswith("b") else f"{name}_nT_per_m" for name in OUTPUT_NAMES))


def write_csv_corrected(path: Path, pieces: Iterable[Corrected]) -> None:
    """Write the centre vector in nT and the gradient tensor in nT/m, piece by piece; nan where there is no gradient.

    Raises
    ------
    InputError
        When the file cannot be written.
    """
    blocks = (np.column_stack([piece.time_s, nanotesla_to_write(piece.outputs)]) for piece in pieces)
    write_blocks(path, COLUMNS, blocks)
