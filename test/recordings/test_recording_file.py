"""Which bytes a recording consists of."""

from hashlib import sha256

import numpy as np
import pytest

from tam_calibration.model.exceptions import InputError
from tam_calibration.model.recording import Recording
from tam_calibration.recordings import provenance
from tam_calibration.results import write_recording

RECORDING = Recording(np.arange(5.0), np.ones((5, 1, 3)))


def test_a_file_is_told_by_its_bytes(tmp_path):
    """Name, size and SHA-256 are those of the file."""
    write_recording(tmp_path / "a.csv", RECORDING)
    content = (tmp_path / "a.csv").read_bytes()
    source = provenance(tmp_path / "a.csv")
    assert (source.name, source.size_bytes, source.sha256) == ("a.csv", len(content), sha256(content).hexdigest())


def test_a_bag_is_told_by_its_data(tmp_path):
    """The folder's name, and the bytes of its data files in order, without the metadata."""
    write_recording(tmp_path / "bag", RECORDING)
    content = (tmp_path / "bag" / "bag.db3").read_bytes()
    source = provenance(tmp_path / "bag")
    assert (source.name, source.size_bytes, source.sha256) == ("bag", len(content), sha256(content).hexdigest())


def test_a_folder_without_bag_is_refused(tmp_path):
    """A folder without metadata is no recording."""
    with pytest.raises(
        InputError, match=r"contains no metadata\.yaml, nor a file that ends in \.db3 or \.mcap or \.bag: is it a bag\?"
    ):
        provenance(tmp_path)
