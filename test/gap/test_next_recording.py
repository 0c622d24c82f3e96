"""What to record next tells two hypotheses apart, or shows what the recording at hand cannot."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.effects.effect import Finding
from tam_calibration.gap.candidates import Setting, signal_of
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.next_recording import _also, ambiguity_of, next_recording, separate
from tam_calibration.gap.regression import Base
from tam_calibration.gap.search import search
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.support import LEAST_EVIDENCE
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.recording import Recording
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
    return next_recording(found, gap.verdict, gap.causes, 1.0)


@pytest.fixture(scope="module")
def doubtful():
    """Return a steady rise of temperature so short and small that a jump explains its drift as well."""
    return diagnosed(effects=(drift(2.8e-10),), temperature=Temperature(18, 22))


@pytest.fixture(scope="module")
def withheld():
    """Return a drift whose temperature is not recorded."""
    return diagnosed(effects=(drift(2e-9),), temperature=Temperature(18, 26), drop=("temperature_C",))


@pytest.mark.parametrize("truth_is_first", [True, False])
def test_the_recording_separates_two_hypotheses_as_well_as_expected(doubtful, truth_is_first):
    """Simulated with noise at the full rate, it brings at least half of the evidence for the true one of two.

    Noise alone lets an effect explain as much as it has visible directions, which are more for one than the other.
    """
    found, gap = doubtful
    ambiguity = ambiguity_of(found, gap.verdict, gap.causes)
    assert {ambiguity.first.effect, ambiguity.second.effect} == {"temperature_drift", "bias_jump"}
    now = found.model.channels().covariates
    setting = Setting(found.model, now, 1.0)
    separation = separate(setting, ambiguity)
    assert separation.now + separation.gained > LEAST_EVIDENCE > separation.now
    candidate = replace(separation.candidate, minutes=separation.minutes)
    covariates = candidate.covariates(now, separation.channels, round(60 * separation.minutes / now.step_s))
    truth, other = (separation.first, separation.second)[:: 1 if truth_is_first else -1]
    rows = np.column_stack([now.errors.distort(covariates.field_T).reshape(-1, 12), covariates.intensity_T])
    rows += signal_of(setting, covariates, truth)
    array = found.model.array
    noise = np.append(np.repeat(array.vector_noise_T, 3), array.scalar_noise_T)
    rows += noise * np.random.default_rng(1).standard_normal(rows.shape)
    recording = Recording(
        covariates.time_s, rows[:, :-1].reshape(-1, 4, 3), rows[:, -1], temperature_C=covariates.temperature_C
    )
    channels = WhitenedChannels.at(recording, array, now.errors, float(np.mean(covariates.intensity_T)))
    base = Base(channels, [channels.calibration])
    gains = []
    for effect in (truth.effect, other.effect):
        shapes = effect.shapes(covariates, channels.residuals)
        found = [base.project(channels.design(effect.terms(covariates, shape))).gain() for shape in shapes]
        gains.append(max(gain - rank for gain, rank in found))
    assert gains[0] - gains[1] > separation.gained / 2


def test_two_hypotheses_are_told_apart_in_words(doubtful):
    """Motion, duration, channel and evidence are told."""
    words = sentence(*doubtful)
    for part in ("temperature drift", "bias jump", "temperature goes down and up", "min", "a turn", "decides"):
        assert part in words


def test_a_missing_channel_is_named(withheld):
    """A drift without its temperature: record the temperature, and change it."""
    found, gap = withheld
    assert gap.verdict in ("unexplained", "partly_explained")
    words = sentence(found, gap)
    assert "with the temperature recorded" in words
    assert "temperature drift" in words


@pytest.mark.parametrize(
    ("current_A", "words"), [(None, " (and the current, which may be the cause as well)"), ([1.0, 2.0], "")]
)
def test_what_another_plausible_effect_needs_is_named_where_it_is_missing(current_A, words):
    """A channel that is recorded, or asked for already, is not asked for again."""
    recording = SimpleNamespace(current_A=current_A, temperature_C=None)
    setting = SimpleNamespace(model=SimpleNamespace(recording=recording))
    plausible = ["current_interference", "temperature_drift"]
    assert _also(setting, plausible, ["temperature_C"]) == words


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
    words = next_recording(replace(found, rivals=(rate,), weighed=()), "unexplained", (), 1.0)
    assert "time skew" in words
    assert "turn it" in words


@pytest.mark.parametrize(
    "rival",
    [
        "function_of_time",
        "function_of_rate",
        "function_of_direction",
        "function_of_tilt",
        "function_of_neighbours",
    ],
)
def test_a_gap_without_a_plausible_effect_asks_what_it_follows(doubtful, rival):
    """With every plausible effect tried, another motion tells what the gap follows."""
    found, _ = doubtful
    strong = replace(found.rivals[0], effect=rival, delta_bic=500.0, gain=500.0)
    words = next_recording(replace(found, rivals=(strong,), weighed=(), considered=()), "unexplained", (), 1.0)
    assert words.startswith("To see what the rest follows")


def test_what_is_not_found_by_regression_is_told_apart_by_what_makes_it_visible(doubtful):
    """Saturation against spikes: turn to the end of the range, several times; no figure is made up."""
    found, _ = doubtful
    fitted = FittedEffect("saturation", {}, (Contribution(1, 0, "limit", {"upper limit": 5e-5}),))
    clipped, spiky = (
        Evidence(name, Finding(replace(fitted, effect=name), 50.0, 2), 40.0, 50.0)
        for name in ("saturation", "outliers")
    )
    words = next_recording(replace(found, weighed=(clipped, spiky)), "unexplained", (), 1.0)
    assert words.startswith(
        "To tell saturation from outliers, record turns that bring the axis to the end of its range"
    )


def test_it_is_cheap(doubtful):
    """It takes a small part of the time of the search."""
    from time import process_time

    found, gap = doubtful
    start = process_time()
    search(found.nominal.recording, found.nominal.array)
    middle = process_time()
    sentence(found, gap)
    assert process_time() - middle < 0.5 * (middle - start)
