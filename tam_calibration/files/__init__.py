"""Reading and writing of arrays, recordings, calibrations, corrected data, scenarios and results."""

from tam_calibration.files.array_yaml import array_to_mapping, read_array, write_array
from tam_calibration.files.calibration_yaml import (
    FORMULA,
    calibration_from_yaml,
    calibration_to_mapping,
    calibration_to_yaml,
    read_calibration,
    write_calibration,
)
from tam_calibration.files.recording_file import (
    provenance,
    read_pieces,
    read_recording,
    read_samples,
    write_corrected,
    write_corrected_pieces,
    write_recording,
)
from tam_calibration.files.text_files import write_whole

__all__ = [
    "FORMULA",
    "array_to_mapping",
    "calibration_from_yaml",
    "calibration_to_mapping",
    "calibration_to_yaml",
    "provenance",
    "read_array",
    "read_calibration",
    "read_pieces",
    "read_recording",
    "read_samples",
    "write_array",
    "write_calibration",
    "write_corrected",
    "write_corrected_pieces",
    "write_recording",
    "write_whole",
]
