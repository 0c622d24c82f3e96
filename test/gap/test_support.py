"""What a residual supports: more than its surrogates, no average of noise, of a size that nature knows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.effects.library import effect_named
from tam_calibration.gap import support
from tam_calibration.gap.hypothesis import Hypothesis, best_form
from tam_calibration.gap.regression import Selection
from tam_calibration.gap.size import Evidence, evidence_of, examine, rivals
from tam_calibration.gap.support import (
    LEAST_EVIDENCE,
    Step,
    energy_explained,
    holds,
    is_new,
    open_part,
    support_of,
    supported,
)
from tam_calibration.gap.surrogates import SurrogateTest
from tam_calibration.model.fitted_effect import ALL, SCALAR


@pytest.fixture(scope="module")
def base(run):
    """Return the calibration of a run in which the scalar magnetometer alone follows the attitude."""
    made = run(600)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    along = field @ np.array([0.6, 0.0, 0.8]) / np.linalg.norm(field, axis=1)
    return made.with_row(12, 6e-9 * along**3 * np.abs(along)).model().base()


def test_the_scalars_own_effect_is_supported_before_what_imitates_it(base):
    """All sensors may imitate the scalar magnetometer with many coefficients."""
    effects = ("hysteresis", "scalar_heading_error", "geomagnetic_drift")
    weighed = [one for one in (examine(base, effect_named(name)) for name in effects) if not isinstance(one, str)]
    found = supported(base, weighed, (), 0.0)
    assert found is not None and found[0].effect == "scalar_heading_error"
    assert found[1] is not None and found[1].ratio > 2
    assert holds(base, found[0])


def test_a_cause_must_explain_its_share(base):
    """Nothing is supported where more energy is asked for than anything explains."""
    weighed = [examine(base, effect_named("scalar_heading_error"))]
    assert supported(base, weighed, (), base.energy) is None


def test_weak_evidence_supports_nothing(base):
    """Below the least evidence a hypothesis does not count, whatever its surrogates."""
    one = replace(examine(base, effect_named("scalar_heading_error")), delta_bic=LEAST_EVIDENCE - 1)
    assert supported(base, [one], (), 0.0) is None


def test_a_product_of_two_axes_is_no_memory(run):
    """Where a function of the direction explains more in the same sensor, an effect of the field alone does not."""
    made = run(900)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    x, y, z = field.T / np.linalg.norm(field, axis=1)
    base = made.with_row(8, 20e-9 * x * y * (1 + 0.5 * z)).model().base()
    cause = evidence_of(base, best_form(base, effect_named("hysteresis")))
    assert cause.delta_bic > LEAST_EVIDENCE
    assert support_of(base, cause) == (False, None)


def test_a_size_that_nature_does_not_know_is_no_cause(run, monkeypatch):
    """A delay of half a millisecond is supported, and is not where delays are known up to a tenth of that."""
    made = run(600)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    rate = np.gradient(field, made.recording.time_s, axis=0)
    base = made.with_row(4, -2e-3 * rate[:, 1]).model().base()
    effect = effect_named("time_skew")
    cause = evidence_of(base, best_form(base, effect))
    assert support_of(base, cause)[0]
    small = {name: replace(limit, largest=5e-5) for name, limit in effect.limits.items()}
    monkeypatch.setattr(type(effect), "limits", small)
    assert support_of(base, replace(cause)) == (False, None)


def standing_as(monkeypatch, ratio, left):
    """Let every form stand so many times above its best surrogate, and leave such a part in its sensors."""
    monkeypatch.setattr(support, "_surrogate_test", lambda base, form: SurrogateTest(100.0 * ratio, 100.0, 0.01))
    monkeypatch.setattr(support, "_unexplained_part", lambda base, form: left)


@pytest.mark.parametrize(
    ("surrogates", "ratio", "left"), [("moved", 4.5, 0.05), ("of_channel", 1.2, 0.25), ("elsewhere", np.inf, 0.05)]
)
def test_a_form_stands_far_out_or_leaves_nothing(base, monkeypatch, surrogates, ratio, left):
    """So many times above its best surrogate it may have others beside it; nearer to it, it must leave little."""
    cause = examine(base, effect_named("scalar_heading_error"))
    monkeypatch.setattr(type(cause.form.effect), "surrogates", surrogates)
    above, below = (ratio * 1.1, max(ratio / 1.3, 1.13)) if np.isfinite(ratio) else (1e3, 1e3)
    for stood, part, is_held in ((above, 1.25, np.isfinite(ratio)), (below, 1.25, False), (below, 0.8, True)):
        standing_as(monkeypatch, stood, part * left)
        assert holds(base, replace(cause)) == is_held


@pytest.mark.parametrize(("ratio", "is_held"), [(1.6, False), (2.4, True)])
def test_a_form_that_promises_may_come_first(base, monkeypatch, ratio, is_held):
    """Twice above its best surrogate, whatever it leaves to others that are still to be found."""
    cause = examine(base, effect_named("scalar_heading_error"))
    standing_as(monkeypatch, ratio, 0.5)
    assert support_of(base, replace(cause))[0] == is_held


def test_a_form_that_gains_no_more_than_its_best_surrogate_is_none(base, monkeypatch):
    """Whatever it leaves: by as much as evidence must have at least, and no less."""
    cause = examine(base, effect_named("scalar_heading_error"))
    for gain, is_held in ((110.0, False), (114.0, True)):
        standing_as(monkeypatch, gain / 100, 0.0)
        assert support_of(base, replace(cause))[0] == is_held


@pytest.mark.parametrize(("ratio", "left", "is_held"), [(21, 0.12, False), (27, 0.12, True), (21, 0.08, True)])
def test_changes_stand_far_out_or_leave_nothing(run, monkeypatch, ratio, left, is_held):
    """A jump beside something else in its sensor must gain two dozen times what a step at another time does."""
    made = run(600)
    base = made.with_row(4, np.where(made.recording.time_s > 20, 9e-9, 0.0)).model().base()
    cause = evidence_of(base, best_form(base, effect_named("bias_jump")))
    standing_as(monkeypatch, 1.0, left)
    monkeypatch.setattr(
        support, "surrogate_test_of_change", lambda *asked: (SurrogateTest(100.0 * ratio, 100.0, 0.01), False)
    )
    assert holds(base, cause) == is_held


def test_an_effect_comes_once_unless_it_may_repeat(base):
    """A second heading error beside the first says nothing new, a second jump in time does."""
    heading = examine(base, effect_named("scalar_heading_error"))
    assert not is_new(heading, [Step(heading, ())], base)
    jump = examine(base, effect_named("bias_jump"))
    assert is_new(jump, [Step(jump, ())], base)


def test_all_is_open_in_front_of_causes(base):
    """What functions without physics explain of the calibration's own residual."""
    unknown = rivals(base)
    assert open_part(base, base, unknown) == pytest.approx(1)
    assert open_part(base, base, ()) == 0
    true = examine(base, effect_named("scalar_heading_error"))
    assert 0 < energy_explained(true, base) < base.energy


@pytest.mark.parametrize(("evidence", "first"), [(600.0, "current_interference"), (400.0, "bias_jump")])
def test_a_recorded_channel_with_more_evidence_comes_before_a_change(base, monkeypatch, evidence, first):
    """Though its surrogates, which have its course in time, explain much, and steps at other times next to nothing."""
    jump, current = (
        evidence_of(base, best_form(base, effect_named(name))) for name in ("bias_jump", "current_interference")
    )
    jump = replace(jump, delta_bic=500.0, gain=520.0)
    current = replace(current, delta_bic=evidence, gain=evidence + 20)
    largest = {jump.effect: 1.0, current.effect: 0.8 * current.gain}
    monkeypatch.setattr(
        support, "support_of", lambda base, one: (True, SurrogateTest(one.gain, largest[one.effect], 0.01))
    )
    found = supported(base, [jump, current], (), 0.0)
    assert found is not None and found[0].effect == first


@pytest.mark.parametrize(("evidence", "is_open"), [(11.9, False), (12.1, True)])
def test_what_is_open_has_the_least_evidence(base, evidence, is_open):
    """A function without physics with less may be noise."""
    unknown = [replace(one, delta_bic=evidence) for one in rivals(base)]
    assert (open_part(base, base, unknown) > 0) == is_open


@pytest.mark.parametrize(
    ("evidence", "follows", "oversize"), [(11.9, False, None), (99.0, True, None), (99.0, False, "too large")]
)
def test_what_needs_no_surrogate_is_refused_before(monkeypatch, evidence, follows, oversize):
    """Too little evidence, what any function of the direction does, and what nature does not have."""
    monkeypatch.setattr(support, "_is_of_direction", lambda base, candidate: follows)
    monkeypatch.setattr(support, "_fitted_at", lambda base, form: None)
    effect = SimpleNamespace(is_free_in_time=False, channels=(), oversize=lambda covariates, fitted: oversize)
    candidate = SimpleNamespace(form=SimpleNamespace(effect=effect, shape={}), delta_bic=evidence)
    base = SimpleNamespace(channels=SimpleNamespace(covariates=None))
    assert support_of.__wrapped__(base, candidate) == (False, None)


@pytest.mark.parametrize(
    ("one", "other", "is_nested"), [("a", "ab", True), ("ab", "a", True), ("a", "b", False), ("a", "a", True)]
)
def test_a_special_case_is_nested_whichever_is_named_first(one, other, is_nested):
    """Of two effects, the letters of one of which are within the other's."""

    def evidence(name):
        effect = SimpleNamespace(name=name, is_within=lambda whole: set(name) <= set(whole))
        return Evidence(name, Hypothesis(effect, {}, (), Selection((), 0.0, 0, 0.0)), 0.0, 0.0)

    assert support._is_nested(evidence(one), evidence(other)) == is_nested


def evidence_in(sensors, rank, delta_bic, gain, name="whole", **facts):
    """Return evidence for an effect with a term in each of some sensors; what is not the whole is within it."""
    within = SimpleNamespace(is_within=lambda other: name != "whole" and other == "whole", nearly_within=(), name=name)
    effect = SimpleNamespace(**(vars(within) | facts))
    terms = tuple(SimpleNamespace(sensor=sensor, axis=None, name="part") for sensor in sensors)
    return Evidence(name, Hypothesis(effect, {}, terms, Selection((), gain, rank, 0.0)), delta_bic, gain)


@pytest.mark.parametrize(("rank", "named"), [(33, "special"), (36, "special"), (37, "whole")])
def test_a_special_case_takes_no_more_coefficients_than_the_whole(rank, named):
    """Else it explains as much because it can imitate anything."""
    whole, special = evidence_in([0], 36, 900.0, 1000.0), evidence_in([0], rank, 890.0, 1000.0, "special")
    assert support.special_case(whole, [whole, special]).effect == named


@pytest.mark.parametrize(
    ("places", "others", "named"),
    [
        ([ALL], [0, 1, 2, 3], "special"),
        ([ALL, SCALAR, 0, 1], [0, 1, 2, 3], "special"),
        ([ALL], [2], "whole"),
        ([ALL], [2, SCALAR], "whole"),
        ([0, 1], [0, 1, 2, 3], "whole"),
    ],
)
def test_one_law_of_all_sensors_is_simpler_than_one_of_each(places, others, named):
    """Whatever they count: selection leaves terms away, and adds what follows channels. Beside one sensor it is not."""
    whole, special = evidence_in(others, 63, 900.0, 1000.0), evidence_in(places, 69, 890.0, 1000.0, "special")
    assert support.special_case(whole, [whole, special]).effect == named


@pytest.mark.parametrize(("delta_bic", "named"), [(810.0, "special"), (720.0, "whole")])
def test_a_whole_must_be_worth_its_coefficients(delta_bic, named):
    """A special case that leaves much, with more evidence for its few coefficients, comes first."""
    whole, special = evidence_in([0, 1], 36, 730.0, 1070.0), evidence_in([SCALAR], 9, delta_bic, 910.0, "special")
    assert support.special_case(whole, [whole, special]).effect == named


@pytest.mark.parametrize(
    ("is_free", "part", "delta_bic", "named"),
    [
        (True, 0.998, 480.0, "pump"),
        (True, 0.997, 480.0, "free"),
        (True, 0.9, 510.0, "pump"),
        (False, 0.998, 510.0, "free"),
    ],
)
def test_a_recorded_channel_that_explains_nearly_as_much_comes_before_free_times(is_free, part, delta_bic, named):
    """Its noise costs evidence far above the floor; that its times are those of the change is no chance."""
    free = evidence_in([0], 12, 500.0, 550.0, "free", is_free_in_time=is_free, surrogates="at_other_times")
    pump = evidence_in([0], 12, delta_bic, part * 550.0, "pump", is_free_in_time=False, surrogates="of_channel",
                       channels=(), needs=lambda fitted: ())  # fmt: skip
    assert support._told(free, [free, pump]).effect == named


@pytest.mark.parametrize(("delta_bic", "named"), [(490.0, "free"), (510.0, "field")])
def test_what_follows_the_field_with_more_evidence_comes_before_free_times(delta_bic, named):
    """That a drift explains little in other rows is no test to compare with the field moved in time."""
    facts = {"channels": (), "needs": lambda fitted: ()}
    free = evidence_in([0], 28, 500.0, 680.0, "free", is_free_in_time=True, surrogates="elsewhere")
    field = evidence_in([0], 9, delta_bic, 700.0, "field", is_free_in_time=False, surrogates="moved", **facts)
    assert support._told(free, [free, field]).effect == named


@pytest.mark.parametrize(
    ("energy", "gain", "nearly", "named"),
    [
        (0.998, 0.9, ("whole",), "special"),
        (0.997, 0.9, ("whole",), "whole"),
        (0.998, 0.9, (), "whole"),
        (0.9, 0.98, (), "special"),
        (0.9, 0.96, ("whole",), "whole"),
    ],
)
def test_a_special_case_leaves_little_evidence_or_as_little_energy_as_models_leave(energy, gain, nearly, named):
    """Far above the noise a twentieth of the amplitude is much evidence; exact limits are held to the evidence."""

    def evidence(name, energy, gain):
        is_special = name == "special"
        effect = SimpleNamespace(
            name=name,
            is_within=lambda whole: is_special and whole == "whole",
            nearly_within=nearly if is_special else (),
        )
        return Evidence(name, Hypothesis(effect, {}, (), Selection((), energy, 9, 0.0)), gain, gain)

    whole, special = evidence("whole", 1e6, 1000.0), evidence("special", 1e6 * energy, 1000 * gain)
    assert support.special_case(whole, [whole, special]).effect == named


def test_further_currents_and_actuators_count_as_recorded(base):
    """A form of an effect of other surrogates follows a channel where one of its terms does."""
    field = effect_named("platform_field")
    selection = Selection((0,), 0.0, 3, 0.0)

    def form(name):
        term = SimpleNamespace(sensor=0, axis=None, name=name)
        return Hypothesis(field, {}, (term,), selection)

    assert support._follows_channel(form("actuator_rudder"))
    assert support._follows_channel(form("current_2_A"))
    assert not support._follows_channel(form("first mode, gradient"))
    for name, follows in (("current_interference", True), ("flexure", False), ("eddy_current", False)):
        term = SimpleNamespace(sensor=0, axis=None, name="field")
        assert support._follows_channel(Hypothesis(effect_named(name), {}, (term,), selection)) == follows
