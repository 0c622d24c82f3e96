"""The section on a known source in a calibration's page: its figures, and nothing where there was none."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.correction.parts import KnownSource
from tam_calibration.model.array import Array
from tam_calibration.model.units import from_degrees
from tam_calibration.report.calibration_report import write_calibration_report


@pytest.fixture
def write(make, tmp_path, read_page, undrawn):
    """Return a function that writes the page of a calibration with a known source and returns its words."""

    def write(known_source, offsets_m=None):
        array = replace(Array.cross(0.5, 1e-9, 1e-10), axis_offsets_m=offsets_m)
        calibration, recording = make(array, known_source=known_source)
        write_calibration_report(tmp_path / "page.html", calibration, recording)
        return read_page(tmp_path / "page.html").text

    return write


def found(reduced_chi_square):
    """Return what a source showed."""
    turn = from_degrees(np.array([0.1, -0.2, 0.3]))
    return KnownSource(0.963, 2e-4, turn, np.full(3, from_degrees(0.01)), np.full((4, 3, 3), 1e-4), reduced_chi_square)


def test_figures_of_the_source_are_on_the_page(write):
    """Scale, turn and places stand in the units of people with their errors."""
    offsets = np.zeros((4, 3, 3))
    offsets[1, 2, 0] = 2.5e-3
    page = write(found(1.1), offsets)
    assert "Known source" in page
    assert "0.96300 ± 0.00020" in page and "−0.200 ± 0.010" in page
    assert re.search(r"2 z\s+2.50 ± 0.10", page)
    assert "too small" not in page


def test_a_source_that_does_not_fit_is_told(write):
    """A large χ² is a doubt."""
    assert "not quite where or what it was stated" in write(found(5.0), np.zeros((4, 3, 3)))


def test_nothing_where_no_source_was_known(write):
    """Other calibrations have no such section."""
    assert "Known source" not in write(None)
