"""When an error changed within a recording: to a block of samples, and only where the samples before it say so."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import UNCHANGING

from tam_calibration.fit import calibrate, prior_changes
from tam_calibration.fit.contradiction import Change, Hypothesis
from tam_calibration.fit.prior import prior_of
from tam_calibration.fit.prior_changes import samples_between, time_of_change
from tam_calibration.fit.problem import Known, posterior_of
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Tumble

DIRECTIONS = np.eye(48)[:, 18:21]
BIAS = Change(Hypothesis("bias of sensor 2", "bias", 2, DIRECTIONS, (), "T"), DIRECTIONS, np.full(3, 0.1e-9**2))
"""Of sensor 2, by a tenth of the noise: as much as some hundred samples tell."""


@pytest.fixture(scope="module")
def known(wu_scenario):
    """Return what is known of the array: a calibration of a full turn."""
    array = replace(wu_scenario.array.with_stated_noise(), change_rates=UNCHANGING)
    return Known(prior_of(calibrate(turned(wu_scenario, 1, 3000), array), None, None))


def turned(scenario, seed, count):
    """Return a recording of a slow turn through all directions."""
    return simulate(
        replace(scenario, motion=Tumble(np.radians(20)), sample_count=count, rate_hz=10.0, seed=seed)
    ).recording


def told(known, scenario, count, first, size_T):
    """Return the sample from which on the bias of sensor 2 is told to have changed, or None."""
    recording = turned(scenario, 2, count)
    readings_T = recording.readings_T.copy()
    readings_T[first:, 1, 0] += size_T
    recording, array = replace(recording, readings_T=readings_T), scenario.array.with_stated_noise()
    posterior = posterior_of(recording, array, known)
    time_s = time_of_change(recording, array, known, posterior, BIAS)
    return None if time_s is None else int(np.searchsorted(recording.time_s, time_s))


@pytest.mark.parametrize(
    ("count", "first", "found"),
    [(3000, 1500, 1500), (1000, 370, 370), (1000, 990, 990), (1000, 10, 10), (100, 40, 40), (95, 40, 40)],
)
def test_a_change_is_placed_at_the_block_in_which_it_was(known, wu_scenario, count, first, found):
    """To a hundredth of the recording: 20 nT, also in the first and the last of the blocks."""
    assert told(known, wu_scenario, count, first, 20e-9) == found


@pytest.mark.parametrize("size_T", [0.5e-9, 20e-9])
def test_what_was_so_from_the_start_has_no_time(known, wu_scenario, size_T):
    """However large it is."""
    assert told(known, wu_scenario, 1000, 0, size_T) is None


@pytest.mark.parametrize(
    ("count", "first", "size_nT", "is_told"),
    [(1000, 370, 0.291, False), (1000, 370, 0.309, True), (100, 40, 2.28, False), (100, 40, 2.37, True)],
)
def test_a_change_within_the_recording_must_convince(known, wu_scenario, count, first, size_nT, is_told):
    """By e⁵ beside the number of times that were tried: three tenths of the noise, of 60 samples more than twice."""
    assert (told(known, wu_scenario, count, first, size_nT * 1e-9) is not None) == is_told


@pytest.mark.parametrize(("energy", "between"), [(46.8, (10, 10)), (46.9, (8, 13))])
def test_samples_fit_unless_chance_is_one_in_a_million(known, wu_scenario, monkeypatch, energy, between):
    """Of ten channels an energy of 46.9: samples beside a change that leave more lie between its two sides."""
    old, new = np.full(20, 1e3), np.full(20, 1e3)
    old[:10] = new[10:] = 9.3
    old[8:10] = new[10:13] = energy
    left = iter([old, new])
    monkeypatch.setattr(prior_changes, "sample_energies", lambda *_: next(left))
    recording, array = turned(wu_scenario, 2, 20), wu_scenario.array.with_stated_noise()
    posterior = posterior_of(recording, array, known)
    assert samples_between(recording, array, known.variance_factors, posterior, posterior) == between
