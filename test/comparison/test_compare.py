from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison import compare
from tam_calibration.fit import calibrate
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording


def test_two_runs_of_one_simulator_are_the_same(run, compared):
    """Other seeds and paths: nothing differs, nothing is to be mended."""
    found = compared(run(1), run(2))
    assert (found.verdict, found.missing, found.surplus, found.mend.added) == ("same", (), (), ())
    assert found.closing.before == found.closing.after == 0


def test_a_missing_effect_is_named_and_closes_the_gap(run, compared):
    """The twin with the mend has the drift: the gap closes but for noise; progress goes over all three."""
    told = []
    found = compared(run(1), run(2, 3), progress=lambda stage, done: told.append(done))
    assert told[0] == 0 and max(told) <= 1 and {int(3 * done) for done in told} >= {0, 1, 2}
    assert (found.verdict, [one.effect for one in found.missing]) == ("differs", ["temperature_drift"])
    closing = found.closing
    assert closing.before > 1 and closing.closed > 0.97 and closing.closed_interval[1] == 1.0
    assert closing.steps[0].added.startswith("temperature drift") and closing.steps[-1].left == closing.after
    assert closing.source_error_after_m < 0.2 * closing.source_error_before_m


def test_a_mend_that_cannot_be_tried_is_told_all_the_same(run, cold, compared):
    """A simulation without temperature beside a recording that drifts with it: only the closing is not known."""
    found = compared(cold, run(2, 3))
    assert found.verdict == "differs" and [one.effect for one in found.missing] == ["temperature_drift"]
    assert not found.missing[0].is_shown_by_other_run and found.mend.added
    assert found.closing.before > 1 and np.isnan(found.closing.after) and found.statement.endswith("cannot be tried.")
    assert "give temperature_C of the simulation" in found.closing.left


def test_noise_that_leaves_the_calibration_open_is_found_and_closed(run, cross):
    """A scalar of few samples, so noisy that no calibration is given: its noise is compared, and closed by the mend."""
    few, other = (run(seed).take(slice(0, None, 8)) for seed in (1, 2))
    noise_T = np.random.default_rng(1).normal(0, 700e-9, len(other.scalar_T))
    noisy = replace(other, scalar_T=other.scalar_T + noise_T)
    with pytest.raises((InputError, Refused), match="although the directions are enough"):
        calibrate(noisy, cross)
    found = compare(few, noisy, cross)
    assert [one.recording.sensor for one in found.noise if one.differs] == [0]
    assert found.noise[-1].recording.level_T == pytest.approx(noise_T.std(), rel=0.25)
    assert found.verdict == "differs" and found.closing.before > 10 and found.closing.after < 1.2
    assert found.recording.gap.noise[-1] is found.noise[-1].recording


def test_a_mistake_is_told_before_anything_is_fitted(run, cross):
    """Gauss for tesla: the mistake stands alone."""
    gauss = run(1)
    wrong = Recording(gauss.time_s, 1e4 * gauss.readings_T, 1e4 * gauss.scalar_T)
    found = compare(wrong, run(2), cross)
    assert found.verdict == "differs" and found.mistakes and found.closing is None


def test_a_run_that_tells_nothing_is_said_by_name(run, compared):
    """An array at rest: the side is named, and nothing is invented."""
    one = run(2)
    still = Recording(
        one.time_s, one.readings_T[:1] + 1e-9 * np.random.default_rng(3).normal(size=one.readings_T.shape)
    )
    found = compared(run(1), still)
    assert found.verdict == "not_identifiable" and "the recording" in found.statement


def test_other_numbers_of_sensors_are_bad_input(run, cross):
    """The two must have one array; the sentence says which has how many."""
    one = run(1)
    alone = Recording(one.time_s, one.readings_T[:, :1], one.scalar_T)
    with pytest.raises(InputError, match="the simulation has 1 sensors, the recording 4"):
        compare(alone, one, cross)
    with pytest.raises(InputError, match="the simulation has 4 sensors, its array 2: give the array file of it"):
        compare(one, one, cross, array_of_simulation=Array(cross.positions_m[:2], 1e-9, 1e-10))


@pytest.mark.parametrize("times", [1e4, 1e-3])
def test_a_recording_in_another_unit_is_bad_input(run, cross, times):
    """Of the side that is held for right: it is named, and the simulation is accused of nothing."""
    one = run(1)
    wrong = Recording(one.time_s, times * one.readings_T, times * one.scalar_T)
    with pytest.raises(InputError, match=r"^the recording: "):
        compare(run(2), wrong, cross)


def test_other_errors_of_the_sensors_are_no_difference_and_are_told(run, compared):
    """A calibration removes them: the verdict stays, and its sentence says by how much they differ."""
    readings_T = run(2).readings_T.copy()
    readings_T[:, 1, 0] += 6e-7
    told = compared(run(1), replace(run(2), readings_T=readings_T)).statement
    assert told.startswith("The same: effects and noise") and "biases by up to 600 nT (sensor 2 x)" in told
