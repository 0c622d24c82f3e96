"""The coil of Wu 2025 Fig. 12."""

import numpy as np
import pytest

from tam_calibration.sources.dipole import VACUUM_PERMEABILITY
from tam_validation.papers import wu2025_coil
from tam_validation.papers.wu2025_coil import AXES, Experiment, Plate, directions
from tam_validation.papers.wu2025_experiment import turntable
from tam_validation.papers.wu2025_sweeps import published_errors

AXIS = directions(60, np.random.default_rng(1))


@pytest.fixture(scope="module")
def experiment():
    """Return the array of Table 2, calibrated as published."""
    case, _ = turntable(1)
    return Experiment.of(case, published_errors(case.recording, as_published=True))


def test_calibrated_array_leaves_what_coil_and_baselines_make(experiment):
    """The loop is no dipole: 3 % of the range at most; before calibration it is less than the paper has."""
    distance = AXES.index("r")
    assert 0.02 * 2.64 < experiment.rmse_m("after", AXIS)[:, distance].max() < 0.03 * 2.64
    assert experiment.rmse_m("before", AXIS)[:, distance].max() < 0.2924


def test_a_metal_table_puts_the_coil_elsewhere(experiment):
    """Eddy currents in a plate of 0.2 m radius and 10 mm, 0.2 m below, make errors of the size that is printed."""
    error = experiment.rmse_m("after", AXIS, Plate(0.2, 0.01, 0.2))[:, AXES.index("r")]
    assert 0.05 < np.median(error) < 0.5


def test_a_plate_without_conductivity_changes_nothing(experiment, monkeypatch):
    """The field of its currents is in proportion to the conductivity as long as they are small."""
    axes = AXIS[:4]
    monkeypatch.setattr(wu2025_coil, "_CONDUCTIVITY", 1.0)
    plate = Plate(0.2, 0.01, 0.2)
    assert np.abs(plate.currents_A).max() < 0.01
    assert experiment.rmse_m("after", axes, plate) == pytest.approx(experiment.rmse_m("after", axes), abs=1e-6)


def test_a_perfect_conductor_keeps_the_flux_out(monkeypatch):
    """Its moment is that of a thin disc, -8 a³/(3 μ₀) B, and at its middle the field along z vanishes."""
    monkeypatch.setattr(wu2025_coil, "_CONDUCTIVITY", 1e14)
    plate = Plate(0.2, 0.001, 0.0)
    moment = np.sum(plate.currents_A.real * np.pi * plate.rings_m**2)
    assert moment == pytest.approx(-8 * 0.2**3 / (3 * VACUUM_PERMEABILITY), rel=0.05)
