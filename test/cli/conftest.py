"""What tests of several commands need."""

import shutil

import pytest


@pytest.fixture
def folder(tmp_path, monkeypatch, files):
    """Give a working folder with copies of the files of a module."""
    monkeypatch.chdir(tmp_path)
    shutil.copytree(files, tmp_path, dirs_exist_ok=True)
    return tmp_path
