from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison.compare import side_of
from tam_calibration.comparison.differences import differences_between
from tam_calibration.comparison.mending import mend_of, mended_twin


@pytest.fixture(scope="module")
def mended(side, cross):
    """Return the mend of a clean simulation beside a drifting recording, and its twin, judged."""
    clean, drifting = side(1), side(2, 3)
    differences = differences_between(clean, drifting)
    mend = mend_of(differences, clean, drifting)
    return mend, side_of(mended_twin(differences, clean, mend, seed=5), cross)


def test_the_twin_of_the_mended_run_has_the_effect(mended, side):
    """The twin is judged as the recording is: nothing is missing any more."""
    _, twin = mended
    assert differences_between(twin, side(2, 3)).are_none


def test_the_twin_takes_the_run_of_the_simulation(mended, side):
    """Times, temperature and attitude are those of the simulation; the noise is another."""
    _, twin = mended
    run = side(1).recording
    assert np.array_equal(twin.recording.time_s, run.time_s) and np.array_equal(twin.recording.attitude, run.attitude)
    assert not np.array_equal(twin.recording.readings_T, run.readings_T)


def test_surplus_effects_are_left_out(side, cross):
    """The twin of a drifting simulation beside a clean recording is clean."""
    drifting, clean = side(2, 3), side(1)
    differences = differences_between(drifting, clean)
    mend = mend_of(differences, drifting, clean)
    assert mend.removed == ("temperature_drift",) and mend.added == ()
    assert side_of(mended_twin(differences, drifting, mend, seed=5), cross).gap.verdict == "no_gap"


def test_the_noise_to_add_completes_that_of_the_recording(side):
    """Of noise of 1.5 times the sheet √(1.5² - 1) is missing."""
    differences = differences_between(side(1), side(2, 0, 1.5))
    mend = mend_of(differences, side(1), side(2, 0, 1.5))
    *axes, scalar = mend.noise
    assert [1e9 * one.white_T for one in axes] == pytest.approx([1.5] * 12, rel=0.1)
    assert [1e9 * one.added_white_T for one in axes] == pytest.approx([1.118] * 12, rel=0.2)
    assert scalar.added_white_T == 0


def test_times_of_effects_go_to_the_run(side):
    """The start of a drift of a recording that began later lies at the start of any run."""
    drifting = side(2, 3)
    late = replace(drifting, recording=replace(drifting.recording, time_s=drifting.recording.time_s + 1e6))
    differences = differences_between(side(1), drifting)
    (missing,) = differences.missing
    begun = replace(missing, fitted=replace(missing.fitted, shape=dict(missing.fitted.shape) | {"start_s": 1e6}))
    mend = mend_of(replace(differences, missing=(begun,)), side(1), late)
    assert mend.added[0].shape["start_s"] == 0
