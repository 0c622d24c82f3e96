from pathlib import Path

import pytest

from tam_calibration.files import text_files
from tam_calibration.files.text_files import configuration_folder
from tam_calibration.model.exceptions import InputError


@pytest.fixture
def package(monkeypatch, tmp_path):
    """Return a folder in which the package seems to be installed."""
    package = tmp_path / "lib" / "python3.12" / "site-packages" / "tam_calibration"
    monkeypatch.setattr(text_files, "__file__", str(package / "files" / "text_files.py"))
    return package


def with_parameters(folder: Path) -> Path:
    """Make a folder with the nodes' parameters and return it."""
    folder.mkdir(parents=True)
    (folder / "tam.yaml").touch()
    return folder


@pytest.mark.parametrize("prefix", [".", "lib/python3.12/site-packages"])  # as pip install --target has it
def test_the_share_above_the_package_is_found(package, tmp_path, prefix):
    """Wherever the prefix is; a folder config of somebody else beside the package is not ours."""
    (package.parent / "config").mkdir(parents=True)
    installed = with_parameters(tmp_path / prefix / "share" / "tam_calibration" / "config")
    assert configuration_folder() == installed


def test_the_sources_come_before_what_is_installed(package, tmp_path):
    """What stands beside the package belongs to it; what is installed above it may be of another version."""
    with_parameters(tmp_path / "share" / "tam_calibration" / "config")
    beside = with_parameters(package.parent / "config")
    assert configuration_folder() == beside


def test_none_is_told_in_a_sentence(package):
    """With the places that were looked at."""
    with pytest.raises(InputError, match="nor share/tam_calibration/config above it; install tam_calibration again"):
        configuration_folder()
