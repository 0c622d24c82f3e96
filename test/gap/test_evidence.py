"""What speaks for a hypothesis, and what keeps one from being tried."""

from dataclasses import replace
from math import log

import numpy as np
import pytest

from tam_calibration.effects.effect import Finding, FoundEffect
from tam_calibration.effects.library import effect_named, installed_effects
from tam_calibration.effects.recursions import lagged
from tam_calibration.gap.hypothesis import Hypothesis, best_form
from tam_calibration.gap.regression import twice_log_likelihood_ratio
from tam_calibration.gap.search import Offers
from tam_calibration.gap.size import (
    Evidence,
    evidence_of,
    examine,
    sharpened,
    unusable,
)
from tam_calibration.model.fitted_effect import FittedEffect


@pytest.fixture(scope="module")
def drifting(run):
    """Return a run whose sensor 2 drifts with temperature."""
    made = run(500)
    return made.with_row(4, 4e-9 * (made.recording.temperature_C - 20))


@pytest.fixture(scope="module")
def base(drifting):
    """Return its calibration."""
    return drifting.model().base()


@pytest.mark.parametrize(
    ("effect", "channel", "words"),
    [
        ("temperature_drift", "temperature_C", "needs the temperature channel"),
        ("current_interference", "current_A", "needs the current channel"),
        ("flexure", "attitude", "needs the attitude channel"),
        ("scalar_heading_error", "scalar_T", "needs the scalar magnetometer channel"),
    ],
)
def test_a_missing_channel_is_named(drifting, effect, channel, words):
    """The sentence names the channel; with it the effect can be tried."""
    covariates = drifting.channels().covariates
    found = unusable(effect_named(effect), replace(drifting.recording, **{channel: None}), covariates)
    assert (found.status, found.effect) == ("channel_missing", effect) and words in found.why
    assert unusable(effect_named(effect), drifting.recording, covariates) is None


def test_what_a_recording_cannot_show_is_told(drifting):
    """A constant temperature shows no drift."""
    covariates = replace(drifting.channels().covariates, temperature_C=np.full(500, 20.0))
    found = unusable(effect_named("temperature_drift"), drifting.recording, covariates)
    assert found.status == "not_identifiable" and "0 K" in found.why


def test_every_effect_is_tried_or_told(drifting):
    """Those that are left out on purpose are neither."""
    made = replace(drifting, recording=replace(drifting.recording, current_A=None))
    considered = Offers(made.model(), {"outliers"}, lambda what, part: None).considered(())
    told = {one.effect: one.status for one in considered}
    assert len(told) == len(considered) and set(told) == set(installed_effects()) - {"outliers"}
    assert told["current_interference"] == "channel_missing" and told["temperature_drift"] == "not_supported"


def test_evidence_for_an_effect_is_its_likelihood_ratio(base):
    """The gain of its form, by the free-scale likelihood of the base's energy."""
    found = examine(base, effect_named("temperature_drift"))
    form = best_form(base, effect_named("temperature_drift"))
    assert isinstance(found.form, Hypothesis) and found.delta_bic == form.selection.delta_bic > 100
    expected = twice_log_likelihood_ratio(base.energy, form.selection.gain, base.channels.count)
    assert found.gain == pytest.approx(expected)


class Stain(FoundEffect):
    """A finding that is given."""

    name = "stain"

    def __init__(self, answer):
        """Keep what is found."""
        self._answer = answer

    def find(self, residuals):
        """Return what is given."""
        return self._answer

    def add(self, rows_T, covariates, fitted, generator):
        """Add nothing."""
        return rows_T


def test_evidence_for_a_finding_is_bic(base):
    """Its gain less the logarithm of the channels for each number that was spent, or why there is none."""
    finding = Finding(FittedEffect("stain", {}, ()), 50.0, 3, is_certain=True)
    found = examine(base, Stain(finding))
    assert found.delta_bic == pytest.approx(50 - 3 * log(base.channels.count))
    assert found.form is finding and found.is_certain
    assert examine(base, Stain("no stain was seen")) == "no stain was seen"


def test_only_promising_shapes_are_refined(run, monkeypatch):
    """What has little of the strongest evidence stays as it is; findings have no shape."""
    made = run(500)
    change = made.recording.temperature_C - 20
    late = lagged(change, made.recording.time_s, 0.07 * np.ptp(made.recording.time_s))  # between those that are tried
    base = made.with_row(4, 4e-9 * late).model().base()
    strong = evidence_of(base, best_form(base, effect_named("temperature_drift")))
    weak = Evidence("temperature_drift", strong.form, 0.1 * strong.delta_bic, 1.0)
    finding = Evidence("stain", Finding(FittedEffect("stain", {}, ()), 1e9, 1), strong.delta_bic, 1.0)
    first, second, third = sharpened(base, [strong, weak, finding])
    assert first.delta_bic > strong.delta_bic + 1 and second is weak and third is finding


@pytest.mark.parametrize(("part", "is_refined"), [(0.96, False), (0.98, True)])
def test_nearly_all_of_the_strongest_evidence_is_promising(base, monkeypatch, part, is_refined):
    """A shape that has them may overtake it."""
    monkeypatch.setattr("tam_calibration.gap.size.refined", lambda base, form: form)
    strong = evidence_of(base, best_form(base, effect_named("temperature_drift")))
    other = replace(strong, delta_bic=part * strong.delta_bic)
    assert (sharpened(base, [strong, other])[1] is not other) == is_refined


@pytest.mark.parametrize(("special", "is_refined"), [("platform_field", True), ("ringing", False)])
def test_a_special_case_of_the_strongest_is_refined(base, monkeypatch, special, is_refined):
    """Else it is compared with the whole at a time constant that is not its own; what is none stays as it is."""
    monkeypatch.setattr("tam_calibration.gap.size.refined", lambda base, form: form)
    strong = evidence_of(base, best_form(base, effect_named("eddy_current")))
    strong = replace(strong, delta_bic=1000.0)
    form = replace(strong.form, effect=effect_named(special))
    other = Evidence(special, form, 500.0, 600.0)
    assert (sharpened(base, [strong, other])[1] is not other) == is_refined
