"""What to record next tells two hypotheses apart, or shows what the recording at hand cannot."""

from dataclasses import replace

import pytest

from tam_calibration.effects.effect import Finding
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.next_recording import close_pair, next_recording
from tam_calibration.gap.search import search
from tam_calibration.gap.size import Evidence
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.attitude import RandomAttitudes
from tam_calibration.simulation.instruments import Temperature

PLAN = replace(read_scenario("warming_up"), effects=(), temperature=None, sample_count=1000, rate_hz=5.0)


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
    """Return a steady rise of temperature so short and small that a jump explains its drift as well."""
    return diagnosed(effects=(drift(2.8e-10),), temperature=Temperature(18, 22))


@pytest.fixture(scope="module")
def withheld():
    """Return a drift whose temperature is not recorded."""
    return diagnosed(effects=(drift(2e-9),), temperature=Temperature(18, 26), drop=("temperature_C",))


def test_two_hypotheses_are_told_apart_in_words(doubtful):
    """By the motion that shows each of them; the temperature is recorded already."""
    found, gap = doubtful
    assert set(close_pair(found, gap.verdict, gap.causes)) == {"temperature_drift", "bias_jump"}
    words = sentence(*doubtful)
    for part in (
        "temperature drift",
        "bias jump",
        "temperature change by some kelvin",
        "same attitudes before and after",
    ):
        assert part in words
    assert "recorded" not in words


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


def test_an_unseen_motion_is_asked_for():
    """A gap that only continuous motion could explain, in poses without one: turn the array."""
    found, _ = diagnosed(motion=RandomAttitudes())
    rate = replace(found.rivals[0], effect="function_of_rate", delta_bic=500.0, gain=500.0)
    words = next_recording(replace(found, rivals=(rate,), weighed=()), "unexplained", ())
    assert "time skew" in words
    assert "turn the array fast and continuously" in words


def test_a_gap_without_a_plausible_effect_asks_what_it_follows(doubtful):
    """With every plausible effect tried, other motions tell what the gap follows."""
    found, _ = doubtful
    strong = replace(found.rivals[0], effect="function_of_tilt", delta_bic=500.0, gain=500.0)
    words = next_recording(replace(found, rivals=(strong,), weighed=(), considered=()), "unexplained", ())
    assert words.startswith("To see what the rest follows")


def test_what_is_not_found_by_regression_is_told_apart_by_what_makes_it_visible(doubtful):
    """Saturation against outliers: turn to the end of the range, for several readings."""
    found, _ = doubtful
    fitted = FittedEffect("saturation", {}, (Contribution(1, 0, "limit", {"upper limit": 5e-5}),))
    clipped, spiky = (
        Evidence(name, Finding(replace(fitted, effect=name), 50.0, 2), 40.0, 50.0)
        for name in ("saturation", "outliers")
    )
    words = next_recording(replace(found, weighed=(clipped, spiky)), "unexplained", ())
    assert words.startswith("To tell saturation from outliers, turn the axis to the end of its range")
