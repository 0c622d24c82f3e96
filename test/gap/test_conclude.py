"""From which sizes on a gap is one, and is explained."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.effects.effect import Finding
from tam_calibration.gap import diagnose
from tam_calibration.gap.conclude import (
    _causes,
    _considered,
    _indistinguishable,
    _places,
    is_drift,
    smallest_gap,
    verdict_on,
)
from tam_calibration.gap.size import Evidence
from tam_calibration.gap.steps import Step
from tam_calibration.model.fitted_effect import Contribution, FittedEffect


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


def test_what_leaves_as_little_is_named_beside_a_cause():
    """As the search found it."""
    step = SimpleNamespace(accepted=SimpleNamespace(form=None), others=("flexure",))
    found = _indistinguishable(step, SimpleNamespace(considered=()))
    assert found == ("flexure",)


@pytest.mark.parametrize("other", [3, 6])
def test_leakage_from_another_sensor_may_be_a_gain(run, other):
    """All sensors read one field: leakage from the same axis of another is a gain, that from another axis is none."""
    made = run()
    windows = np.sin(0.7 * made.recording.time_s) > 0.4
    leaking = made.with_row(0, 3e-4 * windows * made.recording.readings_T.reshape(-1, 12)[:, other + (other == 6)])
    (cause,) = diagnose(leaking.recording, leaking.array).causes
    names = {cause.fitted.effect, *cause.indistinguishable_from}
    assert ({"gain_switching", "crosstalk"} <= names) == (other == 3) and "crosstalk" in names


@pytest.mark.parametrize(("gain", "is_leakage"), [(3e-4, True), (0.03, False)])
def test_a_large_gain_is_no_leakage(run, gain, is_leakage):
    """Sensors that are turned against each other by a degree do not read the same: a hundredth of 130 floors shows."""
    made = run(seed=2)
    windows = np.sin(0.7 * made.recording.time_s) > 0.4
    amplified = made.with_row(4, gain * windows * made.recording.readings_T[:, 1, 1])
    (cause,) = diagnose(amplified.recording, amplified.array).causes
    assert cause.fitted.effect == "gain_switching"
    assert ("crosstalk" in cause.indistinguishable_from) == is_leakage


@pytest.mark.parametrize(("course", "is_one"), [(np.linspace(18, 26, 300), True), (20 + np.sin(np.arange(300)), False)])
def test_a_channel_that_only_rises_is_a_drift(run, course, is_one):
    """Any other slow course explains as much as it."""
    recording = replace(run(300).recording, temperature_C=course)
    assert is_drift("temperature_drift", recording) == is_one
    assert not is_drift("bias_jump", recording)


@pytest.mark.parametrize(("part", "sensors"), [(0.09, {1}), (0.11, {1, 2})])
def test_a_sensor_has_an_effect_from_a_tenth_of_the_largest_on(run, part, sensors):
    """Less is what the common field carries over from the other."""
    parts = tuple(
        Contribution(sensor, axis, "offset", {"offset": size})
        for sensor, size in ((1, 1e-9), (2, part * 1e-9))
        for axis in range(3)
    )
    fitted = FittedEffect("temperature_drift", {"time_constant_s": 0.0, "reference_C": 20.0}, parts)
    assert {sensor for sensor, _ in _places(fitted, run(60).channels().covariates)} == sensors


@pytest.mark.parametrize(("evidence", "why"), [(11.9, "noise alone"), (12.1, "it leaves a part of the law")])
def test_why_an_effect_is_no_cause_is_told(evidence, why):
    """Odds of 400 to one in white noise, or less."""
    weighed = tuple(SimpleNamespace(effect=name, delta_bic=evidence) for name in ("bias_jump", "flexure"))
    cause = SimpleNamespace(fitted=FittedEffect("bias_jump", {}, ()), delta_bic=90.0, r2_cv=0.8)
    named, one = _considered(SimpleNamespace(considered=(), weighed=weighed), (cause,))
    assert (named.status, named.delta_bic, named.r2_cv) == ("supported", 90.0, 0.8)
    assert (one.status, one.delta_bic) == ("not_supported", evidence) and one.why.startswith(why)


def test_what_is_found_twice_is_one_cause_with_the_evidence_of_the_first(run):
    """Spikes that another step has taken up beside: their energies add up, and the share is of what closes."""
    fitted = FittedEffect("outliers", {}, (Contribution(1, 0, "offset", {"count": 5.0}),))
    findings = [Finding(fitted, gain, 1, flagged=np.arange(60) == at) for at, gain in ((3, 300.0), (9, 100.0))]
    steps = tuple(Step(Evidence("outliers", one, one.gain - 10, one.gain), None) for one in findings)
    model = replace(run(60).model(), findings=tuple(findings))
    found = SimpleNamespace(steps=steps, nominal=model, considered=())
    (cause,) = _causes(found, model, SimpleNamespace(closed=0.8), {"outliers": 0.9})
    assert (cause.delta_bic, cause.probability, cause.sensors) == (290.0, 0.9, (2,))
    assert (cause.share, cause.r2_cv) == (pytest.approx(1.0), pytest.approx(0.8))


@pytest.mark.parametrize(("row", "found"), [(5, "explained"), (8, "partly_explained")])
def test_what_another_sensor_has_beside_a_cause_is_open(run, row, found):
    """A tone that runs away, which no function without physics is, beside a jump of sensor 2, there and in sensor 3."""
    made = run(900)
    time_s = made.recording.time_s
    runaway = 1.2e-9 * np.sin(2 * np.pi * (1 + 0.06 * time_s) * time_s)
    jump = np.where(time_s > 25, 30e-9, 0.0)
    gap = diagnose(made.with_row(4, jump).with_row(row, runaway).recording, made.array)
    assert [cause.fitted.effect for cause in gap.causes] == ["bias_jump"]
    assert gap.verdict == found
