"""Which causes are told by their names, and when unknown parts of two runs may be one."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison.agreement import energy_of
from tam_calibration.comparison.differences import differences_between, likely_causes, may_be_same, unknown_part
from tam_calibration.comparison.result import UNKNOWN, EffectDifference


def opened(side, after=2.0, **cause):
    """Return a side that its one cause leaves an unknown part of so many noise floors."""
    gap = side.gap
    causes = tuple(replace(one, **cause) for one in gap.causes)
    verdict = "partly_explained" if causes else "unexplained"
    size = replace(gap.size, before=float(np.hypot(gap.size.before, after)), after=after)
    where = replace(gap.where, sensors=(2,), axes=("x",))
    return replace(side, gap=replace(gap, verdict=verdict, causes=causes, size=size, where=where))


@pytest.mark.parametrize(("probability", "names"), [(0.51, ["temperature_drift"]), (0.49, [])])
def test_what_is_unlikely_belongs_to_the_unknown_part(side, probability, names):
    """Beside an unknown part a cause is told if it is likelier than not; its energy counts once in either case."""
    found = opened(side(2, 3), probability=probability)
    assert [one.fitted.effect for one in likely_causes(found)] == names
    named = sum(energy_of([cause], found) for cause in likely_causes(found))
    assert unknown_part(found).size ** 2 + named == pytest.approx(found.gap.size.before**2)


def test_a_cause_that_explains_all_is_told_however_unlikely(side):
    """Where nothing is open there is no unknown part that it could belong to."""
    drifting = side(2, 3)
    unsure = replace(drifting, gap=replace(drifting.gap, causes=(replace(drifting.gap.causes[0], probability=0.2),)))
    assert len(likely_causes(unsure)) == 1 and unknown_part(unsure) is None


@pytest.mark.parametrize(("sensors", "size", "alike"), [((1,), 2.1, True), ((1,), 1.9, False), ((2,), 4.0, False)])
def test_unknown_parts_of_one_place_and_nearly_one_size_may_be_one(sensors, size, alike):
    """Half the size is the least."""
    one, other = (
        EffectDifference(UNKNOWN, place, ("x",), 0.9, large, True) for place, large in (((1,), 4.0), (sensors, size))
    )
    assert may_be_same(one, other) == may_be_same(other, one) == alike


def test_unknown_parts_that_may_be_one_are_no_difference_but_a_remark(side):
    """Neither is missing nor surplus, other noise is not told beside them, and what they may be worth is stated."""
    one, other = opened(side(1), 3.0), opened(side(2, 0, 1.5), 4.0)
    found = differences_between(one, other)
    assert (found.missing, found.surplus) == ((), ())
    assert [words for words, _ in found.energies] == ["other noise (sensors 1, 2, 3 and 4)"]
    same = [(noise.recording.sensor, noise.recording.axis) for noise in found.noise if not noise.differs]
    assert same == [(2, "x"), (0, "")]
    assert found.undecided_energy == pytest.approx(4.0**2)
    assert "the two cannot tell" in found.remarks[0]


def test_unknown_parts_of_other_sizes_are_told(side):
    """One of a tenth of the other is another: both are told, each on its side."""
    found = differences_between(opened(side(1), 0.4), opened(side(2), 4.0))
    assert [one.effect for one in (*found.missing, *found.surplus)] == [UNKNOWN, UNKNOWN] and not found.remarks


def test_what_the_mended_run_cannot_show_is_not_left(side, cold, judge):
    """An effect that the simulation's run would not show counts before the mend, and not as left after it."""
    found = differences_between(judge(cold), side(2, 3))
    assert [one.is_shown_by_other_run for one in found.missing] == [False] and found.energy > 1
    assert "or its run could not show" in found.energies[0][0]
    assert found.that_show.missing == () and list(found.that_show.energies) == list(found.energies[1:])
    shown = differences_between(side(1), side(2, 3))
    assert shown.that_show.energy == shown.energy
