from collections import Counter

from tam_validation.blind import KINDS
from tam_validation.blind.case_plan import OF_SCALAR, plan_cases
from tam_validation.blind.catalogue import CATALOGUE, CAUSES


def test_a_set_holds_every_kind_and_effect():
    """Six hundred cases hold all kinds, every effect at every gap, and the same for the same seed."""
    plans = plan_cases(KINDS, 600, 7)
    assert len(plans) == 600 and plans == plan_cases(KINDS, 600, 7)
    assert {plan.kind for plan in plans} == set(KINDS)
    single = Counter((plan.effects, plan.gaps) for plan in plans if plan.kind == "single")
    assert len(single) == 3 * len(CATALOGUE) and min(single.values()) >= 3


def test_the_order_of_a_set_tells_nothing():
    """Kinds are mixed."""
    kinds = [plan.kind for plan in plan_cases(KINDS, 400, 7)]
    assert len(set(kinds[:40])) >= 4


def test_a_mixture_is_two_floors_known_beside_one_unknown():
    """The known cause comes first; every mixture and pair has a motion that shows both."""
    mixed = plan_cases(("mixed",), 60, 3)
    assert {plan.gaps for plan in mixed} == {(2.0, 1.0)} and len(mixed) == 60
    for plan in mixed + plan_cases(("pair",), 60, 3):
        assert set(CAUSES[plan.effects[0]].motions) & set(CAUSES[plan.effects[1]].motions)
    assert all(plan.effects[0] in CATALOGUE and plan.effects[1] not in CATALOGUE for plan in mixed)
    assert not any(CATALOGUE[plan.effects[0]].coarse for plan in mixed), "a noisy sensor hides what is beside it"


def test_mixtures_of_a_small_set_are_all_unlike():
    """A known cause meets another unknown one each time, and none of the scalar when it is of the scalar itself."""
    mixed = [plan.effects for plan in plan_cases(("mixed",), 200, 3)]
    assert len(set(mixed)) > 150
    assert not any(known in OF_SCALAR and CAUSES[unknown].scalar_needed for known, unknown in mixed)


def test_large_gaps_are_those_that_nature_has():
    """Gaps of thirty floors for all, of a thousand for what can be so large."""
    plans = Counter((plan.effects[0], plan.gaps[0]) for plan in plan_cases(("large",), 200, 3))
    assert {name for name, gap in plans if gap == 30} == set(CATALOGUE)
    assert {name for name, gap in plans if gap == 1000} == {name for name in CATALOGUE if 1000 in CATALOGUE[name].large}
    assert "geomagnetic_drift" not in {name for name, gap in plans if gap == 1000}
