"""The files that the package writes: calibrations, corrected data, simulated recordings, results as JSON."""

from tam_calibration.results.calibration_yaml import (
    FORMULA,
    calibration_from_yaml,
    calibration_to_mapping,
    calibration_to_yaml,
    read_calibration,
    write_calibration,
)
from tam_calibration.results.data_files import write_corrected_pieces, write_recording

__all__ = [
    "FORMULA",
    "calibration_from_yaml",
    "calibration_to_mapping",
    "calibration_to_yaml",
    "read_calibration",
    "write_calibration",
    "write_corrected_pieces",
    "write_recording",
]
