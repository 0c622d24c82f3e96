from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison.compare import mend_of, mended_twin
from tam_calibration.comparison.differences import differences_between


def mended(simulation, recording):
    """Return the mend of a simulation beside a recording, and its twin."""
    differences = differences_between(simulation, recording)
    mend = mend_of(differences, simulation, recording)
    return mend, mended_twin(differences, simulation, mend, seed=5)


def test_the_twin_takes_the_run_of_the_simulation(side):
    """Times, temperature and attitude are those of the simulation; the noise is another."""
    _, twin = mended(side(1), side(2, 3))
    run = side(1).recording
    for channel in ("time_s", "temperature_C", "attitude"):
        assert np.array_equal(getattr(twin, channel), getattr(run, channel))
    assert not np.array_equal(twin.readings_T, run.readings_T)


def test_surplus_effects_are_left_out(side, run):
    """Of a drifting simulation beside a clean recording nothing of 3 nT/K stays in the twin."""
    mend, twin = mended(side(2, 3), side(1))
    assert mend.removed == ("temperature_drift",) and mend.added == ()
    drift, left = (
        np.polyfit(one.temperature_C, (one.readings_T - run(2).readings_T)[:, 1], 1)[0] for one in (run(2, 3), twin)
    )
    assert drift == pytest.approx([3e-9, -1.5e-9, 2.4e-9]) and np.abs(left).max() < 0.15e-9


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
