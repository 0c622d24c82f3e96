"""Reading of recordings in any format, and of the array file that describes them."""

from tam_calibration.recordings.array_yaml import array_to_mapping, read_array, transforms_in, write_array
from tam_calibration.recordings.recording_file import provenance, read_pieces, read_recording, read_samples

__all__ = [
    "array_to_mapping",
    "provenance",
    "read_array",
    "read_pieces",
    "read_recording",
    "read_samples",
    "transforms_in",
    "write_array",
]
