"""What tests of fits share: runs, an array with its noise, and what is known of it from the day before."""

from dataclasses import replace

import pytest
from moved_sensors import day_old

from tam_calibration.simulation import simulate


@pytest.fixture(scope="session")
def array(wu_scenario):
    """Return the array with its noise."""
    return wu_scenario.array.with_stated_noise()


@pytest.fixture(scope="session")
def prior(wu_scenario):
    """Return a day-old calibration of the whole sphere."""
    return day_old(wu_scenario)


@pytest.fixture(scope="session")
def wu_runs(wu_scenario):
    """Return twenty of Wu's runs that differ in their noise."""
    return [simulate(replace(wu_scenario, seed=seed)) for seed in range(20)]
