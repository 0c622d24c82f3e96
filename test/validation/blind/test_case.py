import numpy as np
import pytest
from numpy.testing import assert_array_equal

from tam_validation.blind.case import make_case
from tam_validation.blind.case_plan import GAPS, CasePlan
from tam_validation.blind.catalogue import CATALOGUE, CAUSES


def test_cases_follow_from_their_seed():
    """The same seed and number make the same case, another number another one."""
    plan = CasePlan("single", ("bias_jump",), (1.0,))
    first, again, other = make_case(plan, 5, 1), make_case(plan, 5, 1), make_case(plan, 5, 2)
    assert first.key == again.key and first.array == again.array
    for name, values in first.columns.items():
        assert_array_equal(values, again.columns[name])
    assert first.key != other.key


@pytest.mark.parametrize("name", CAUSES)
@pytest.mark.parametrize("gap", [GAPS[0], GAPS[-1]])
def test_every_cause_reaches_its_gap(name, gap):
    """Each is there alone with the gap asked for, and with the channel that decides for it."""
    case = make_case(CasePlan("single" if name in CATALOGUE else "outside", (name,), (gap,)), 1, 1)
    assert case.key["visible_gap"] == pytest.approx(gap, rel=0.02)
    assert [cause["effect"] for cause in case.key["effects"]] == [name]
    column = {"temperature": "temperature_C", "current": "current_A", "attitude": "qw", "": "time_s"}
    assert column[CAUSES[name].channel] in case.columns
    assert {len(values) for values in case.columns.values()} == {case.key["samples"]}


@pytest.mark.parametrize("effect", [name for name, entry in CATALOGUE.items() if entry.channel])
def test_a_withheld_channel_is_not_in_the_file(effect):
    """The channel that would decide is left out, and the key says which."""
    case = make_case(CasePlan("withheld", (effect,), (1.0,)), 1, 1)
    column = {"temperature": "temperature_C", "current": "current_A", "attitude": "qw"}[case.key["withheld_channel"]]
    assert case.key["withheld_channel"] == CATALOGUE[effect].channel
    assert column not in case.columns


def test_noise_is_within_an_eighth_of_the_data_sheet():
    """The array file tells noise that is wrong by no more than 12 %, in some cases not at all."""
    keys = [make_case(CasePlan("clean", (), ()), 2, number) for number in range(1, 13)]
    ratios = np.array([case.key["vector_noise_nT"] / case.array["vector_noise_nT"] for case in keys])
    assert (np.abs(ratios - 1) < 0.121).all() and np.ptp(ratios) > 0.05
    assert np.isclose(ratios, 1, atol=1e-5).any()
