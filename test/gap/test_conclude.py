"""From which sizes on a gap is one and is explained, and what to record next."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.gap import diagnose
from tam_calibration.gap.conclude import conclude, next_recording, smallest_gap, verdict_on
from tam_calibration.gap.laws.law import Signature, causes_of
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.search import search
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import simulate
from tam_calibration.simulation.conditions import Temperature


def verdict(has_cause, *, left=0.0, laws=(), **size):
    """Return the verdict on a search that leaves a part of the laws open."""
    found = SimpleNamespace(steps=("a step",) * has_cause, laws=laws, explains_all=left < 0.1)
    sizes = SimpleNamespace(**{"before": 2.0, "after": 0.05, "closed": 0.9, **size})
    return verdict_on(found, sizes)


@pytest.mark.parametrize(
    ("told", "found"),
    [
        ({"before": 0.09, "laws": ("a law",)}, "no_gap"),
        ({"before": 0.11, "laws": ("a law",)}, "unexplained"),
        ({"before": 0.66}, "no_gap"),
        ({"before": 0.67}, "unexplained"),
        ({"laws": ("a law",)}, "unexplained"),
    ],
)
def test_what_no_cause_explains_is_a_gap(told, found):
    """From a tenth of the noise floor on with a law; without one, beyond noise of 1.2 times that of the sheet."""
    assert verdict(False, **told) == found


@pytest.mark.parametrize(
    ("told", "found"),
    [
        ({"before": 0.09}, "no_gap"),
        ({"before": 0.11}, "explained"),
        ({"closed": 0.24}, "unexplained"),
        ({"closed": 0.26}, "partly_explained"),
        ({"closed": 0.49}, "partly_explained"),
        ({"closed": 0.51}, "explained"),
        ({"after": 0.95}, "explained"),
        ({"after": 1.05}, "partly_explained"),
        ({"left": 0.09}, "explained"),
        ({"left": 0.11}, "partly_explained"),
    ],
)
def test_causes_explain_what_they_close(told, found):
    """A quarter at least; all of it where half closes, a tenth is visible and no more than a noise floor is left."""
    assert verdict(True, **told) == found


@pytest.mark.parametrize(("count", "smallest"), [(100, 0.4075), (1000, 0.1375), (1900, 0.1014), (1e6, 0.1)])
def test_the_smallest_gap_has_the_least_evidence_with_one_coefficient(count, smallest):
    """As g² n is ln n + 12, and a tenth of the noise floor at least."""
    assert smallest_gap(count) == pytest.approx(smallest, abs=1e-4)


@pytest.mark.parametrize(("row", "found"), [(5, "explained"), (8, "partly_explained")])
def test_what_another_sensor_has_beside_a_cause_is_open(run, row, found):
    """A tone that runs away, which no function without physics is, beside a jump of sensor 2, there and in sensor 3."""
    made = run(600)
    time_s = made.recording.time_s
    runaway = 1.5e-9 * np.sin(2 * np.pi * (1 + 0.06 * time_s) * time_s)
    jump = np.where(time_s > 25, 30e-9, 0.0)
    gap = diagnose(made.with_row(4, jump).with_row(row, runaway).recording, made.array)
    assert [cause.fitted.effect for cause in gap.causes] == ["bias_jump"]
    assert gap.verdict == found


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
