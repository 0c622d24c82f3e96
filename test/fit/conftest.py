"""Runs of Wu's Table 1 array for the tests of the fits."""

from dataclasses import replace

import pytest

from tam_calibration.files.scenario import read_scenario
from tam_calibration.simulation import simulate


@pytest.fixture(scope="session")
def wu_scenario():
    """Return Wu's Table 1 scenario: 360 random attitudes, 1 nT and 0.1 nT of noise."""
    return read_scenario("wu_table_1")


@pytest.fixture(scope="session")
def wu_run(wu_scenario):
    """Return one simulated run of it."""
    return simulate(wu_scenario)


@pytest.fixture(scope="session")
def noise_free(wu_scenario):
    """Return the same run without noise; its array still states the noise."""
    silent = replace(wu_scenario, array=replace(wu_scenario.array, vector_noise_T=None, scalar_noise_T=None))
    return simulate(silent)
