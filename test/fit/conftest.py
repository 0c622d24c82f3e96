"""What tests of updates share: an array with its noise, and what is known of it from the day before."""

import pytest
from moved_sensors import day_old


@pytest.fixture(scope="session")
def array(wu_scenario):
    """Return the array with its noise."""
    return wu_scenario.array.with_stated_noise()


@pytest.fixture(scope="session")
def prior(wu_scenario):
    """Return a day-old calibration of the whole sphere."""
    return day_old(wu_scenario)
