"""Which effects are causes of their own: no repetition, no special case of another that explains as much."""

from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.effects.library import effect_named
from tam_calibration.gap import steps
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis
from tam_calibration.gap.regression import Selection
from tam_calibration.gap.size import Evidence, examine
from tam_calibration.gap.steps import Step, is_new
from tam_calibration.model.fitted_effect import ALL, SCALAR


@pytest.fixture(scope="module")
def base(run):
    """Return the calibration of a run in which the scalar magnetometer alone follows the attitude."""
    made = run(600)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    along = field @ np.array([0.6, 0.0, 0.8]) / np.linalg.norm(field, axis=1)
    return made.with_row(12, 6e-9 * along**3 * np.abs(along)).model().base()


def test_an_effect_comes_once_unless_it_may_repeat(base):
    """A second heading error beside the first says nothing new, a second jump in time does."""
    heading = examine(base, effect_named("scalar_heading_error"))
    assert not is_new(heading, [Step(heading, None)], base)
    jump = examine(base, effect_named("bias_jump"), EVERYWHERE, ((20.0,),))
    assert is_new(jump, [Step(jump, None)], base)


@pytest.mark.parametrize(
    ("one", "other", "is_nested"), [("a", "ab", True), ("ab", "a", True), ("a", "b", False), ("a", "a", True)]
)
def test_a_special_case_is_nested_whichever_is_named_first(one, other, is_nested):
    """Of two effects, the letters of one of which are within the other's."""

    def effect(name):
        return SimpleNamespace(name=name, is_within=lambda whole: set(name) <= set(whole))

    assert steps._is_nested(effect(one), effect(other)) == is_nested


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
    assert steps.special_case(whole, [whole, special]).effect == named


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
    assert steps.special_case(whole, [whole, special]).effect == named


@pytest.mark.parametrize(("delta_bic", "named"), [(810.0, "special"), (720.0, "whole")])
def test_a_whole_must_be_worth_its_coefficients(delta_bic, named):
    """A special case that leaves much, with more evidence for its few coefficients, comes first."""
    whole, special = evidence_in([0, 1], 36, 730.0, 1070.0), evidence_in([SCALAR], 9, delta_bic, 910.0, "special")
    assert steps.special_case(whole, [whole, special]).effect == named


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
    assert steps.special_case(whole, [whole, special]).effect == named
