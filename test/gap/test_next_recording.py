"""What to record next tells two hypotheses apart, or shows what the recording at hand cannot."""

from dataclasses import replace

import pytest

from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.laws.law import Signature, causes_of
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.next_recording import next_recording
from tam_calibration.gap.search import search
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.surroundings import Temperature

PLAN = replace(read_scenario("warming_up"), effects=(), temperature=None, sample_count=500, rate_hz=2.5)


def drift(size_T_per_K):
    """Return a drift of sensor 2's x axis with temperature."""
    shape = {"time_constant_s": 20.0, "reference_C": 22.0}
    return FittedEffect("temperature_drift", shape, (Contribution(1, 0, "offset", {"offset": size_T_per_K}),))


def diagnosed(*, without=(), drop=(), **changes):
    """Return what is found in a simulated recording, with its verdict and causes."""
    scenario = replace(PLAN, **changes)
    recording = replace(simulate(scenario).recording, **dict.fromkeys(drop))
    found = search(recording, scenario.array, without)
    return found, conclude(found)


def sentence(found, gap):
    """Return what to record next."""
    return next_recording(found, gap.verdict, gap.causes)


@pytest.fixture(scope="module")
def doubtful():
    """Return a drift with a temperature that rises throughout."""
    return diagnosed(effects=(drift(2.8e-10),), temperature=Temperature(18, 22))


@pytest.fixture(scope="module")
def withheld():
    """Return a drift whose temperature is not recorded."""
    return diagnosed(effects=(drift(2e-9),), temperature=Temperature(18, 26), drop=("temperature_C",))


def test_a_temperature_that_only_rises_shall_rise_and_fall(doubtful):
    """Until then any other slow drift explains as much, and the sentence says so."""
    _, gap = doubtful
    assert [cause.fitted.effect for cause in gap.causes] == ["temperature_drift"] and gap.causes[0].is_drift
    assert "or by anything else that changes as slowly" in gap.statement
    assert sentence(*doubtful).startswith("Let the channel of temperature drift rise and fall several times")


def test_a_missing_channel_is_named(withheld):
    """A drift without its temperature: record the temperature, and change it."""
    found, gap = withheld
    assert gap.verdict in ("unexplained", "partly_explained")
    words = sentence(found, gap)
    assert "with the temperature recorded" in words
    assert "temperature drift" in words


def test_no_gap_needs_nothing_more():
    """Clean data: nothing more is needed."""
    found, gap = diagnosed()
    assert gap.verdict == "no_gap"
    assert sentence(found, gap).startswith("No further recording is needed")


def test_a_sure_cause_needs_a_confirmation_only():
    """A cause that nothing else comes near: nothing more is needed."""
    delay = FittedEffect("time_skew", {}, (Contribution(1, None, "delay", {"delay": 1e-4}),))
    found, gap = diagnosed(effects=(delay,))
    assert gap.verdict == "explained"
    assert sentence(found, gap).startswith("No further recording is needed")


def test_what_would_prove_the_first_candidate_is_asked_for(doubtful):
    """With every effect tried the first cause of the strongest law; without one, other motions."""
    found, _ = doubtful
    loop = Signature("own_field", "motion", (2,), ("x",), 0.9, ((2,),), "motion", (), 50.0)
    open_law = replace(found, laws=(Law(loop, 0.5),), weighed=(), considered=())
    assert next_recording(open_law, "unexplained", ()).startswith(
        f"To see whether it is “{causes_of(loop)[0].title}”, "
    )
    assert next_recording(replace(open_law, laws=()), "unexplained", ()).startswith("To see what the rest follows")


def test_what_cannot_be_told_apart_is_by_what_makes_it_visible(doubtful):
    """Saturation against outliers: turn to the end of the range, for several readings."""
    found, gap = doubtful
    few = replace(
        gap.causes[0],
        fitted=replace(gap.causes[0].fitted, effect="saturation"),
        indistinguishable_from=("outliers", "stale_samples"),
    )
    words = next_recording(found, "explained", (few,))
    assert words.startswith("To tell saturation from outliers, turn the axis to the end of its range")
