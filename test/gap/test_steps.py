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


@pytest.mark.parametrize(("delta_bic", "named"), [(740.0, "special"), (720.0, "whole")])
def test_a_special_case_with_more_evidence_comes_first(delta_bic, named):
    """It leaves more, and takes fewer coefficients."""

    def evidence(name, delta_bic):
        effect = SimpleNamespace(is_within=lambda other: name != "whole" and other == "whole", name=name)
        return Evidence(name, Hypothesis(effect, {}, (), Selection((), 0.0, 0, 0.0)), delta_bic, delta_bic)

    whole, special = evidence("whole", 730.0), evidence("special", delta_bic)
    assert steps.special_case(whole, [whole, special]).effect == named
