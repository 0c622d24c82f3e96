from collections import Counter

from tam_calibration.blind import KINDS
from tam_calibration.blind.plan import plan_cases


def test_a_set_holds_every_kind_and_effect():
    """Four hundred cases hold all kinds, every effect at every gap, and the same for the same seed."""
    plans = plan_cases(KINDS, 400, 7)
    assert len(plans) == 400 and plans == plan_cases(KINDS, 400, 7)
    assert {plan.kind for plan in plans} == set(KINDS)
    single = Counter((plan.effects, plan.gaps) for plan in plans if plan.kind == "single")
    assert len(single) == 48 and min(single.values()) >= 4


def test_the_order_of_a_set_tells_nothing():
    """Kinds are mixed."""
    kinds = [plan.kind for plan in plan_cases(KINDS, 400, 7)]
    assert len(set(kinds[:40])) >= 4
