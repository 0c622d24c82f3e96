"""Correcting a recording that is read from its file, in pieces where that can be."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from tam_calibration.calibration import Calibration, Corrected
from tam_calibration.exceptions import InputError
from tam_calibration.files.recording_file import TOLERANCE_S, read_pieces, read_samples
from tam_calibration.files.samples import Progress


def correct_file(
    path: Path,
    calibration: Calibration,
    tolerance_s: float = TOLERANCE_S,
    progress: Progress = lambda done, total: None,
) -> Iterator[tuple[Corrected, NDArray[np.int64] | None]]:
    """Yield the corrected pieces of a recording with their stamps, None where they were no messages.

    Raises
    ------
    InputError
        When it cannot be read, and at the end when it is mostly not in tesla.
    """
    source = path, calibration.errors.sensor_count, tolerance_s, progress
    # Effects reach from one piece into the next, and holes in their channels are filled from both sides.
    pieces = [read_samples(*source)] if calibration.effects else read_pieces(*source)
    wrong_units: list[InputError] = []
    right_units = 0
    for samples in pieces:
        if calibration.effects:
            corrected = calibration.correct(samples.recording)
        else:
            outputs = calibration.apply(samples.recording.readings_T)
            corrected = Corrected(samples.recording.time_s, outputs, calibration.output_standard_errors)
        try:
            samples.recording.check_units(calibration.array.field)
            right_units += 1
        except InputError as problem:
            wrong_units.append(problem)
        yield corrected, samples.stamps_ns
    if len(wrong_units) > right_units:
        raise wrong_units[0]
