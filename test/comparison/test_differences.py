from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.comparison.differences import differences_between


def with_drift(side, times=1.0, sensor=2):
    """Return a side whose drift was found so many times as large, and in another sensor."""
    (cause,) = side.gap.causes
    contributions = tuple(
        replace(one, sensor=sensor - 1, values={name: times * value for name, value in one.values.items()})
        for one in cause.fitted.contributions
    )
    other = replace(cause, sensors=(sensor,), fitted=replace(cause.fitted, contributions=contributions))
    return replace(side, gap=replace(side.gap, causes=(other,)))


def test_an_effect_of_one_side_is_missing_or_surplus(side):
    """It is named on the side that has it, with its sensor, and all its energy counts."""
    clean, drifting = side(1), side(2, 3)
    found = differences_between(clean, drifting)
    (missing,) = found.missing
    assert (missing.effect, missing.sensors, found.surplus) == ("temperature_drift", (2,), ())
    assert found.energy == pytest.approx(drifting.gap.size.before**2, rel=0.05)
    back = differences_between(drifting, clean)
    assert [one.effect for one in back.surplus] == ["temperature_drift"] and back.missing == ()


def test_the_run_that_could_have_shown_an_effect_is_known(side):
    """The clean run has a temperature that rises too: it would show the drift."""
    (missing,) = differences_between(side(1), side(2, 3)).missing
    assert missing.is_shown_by_other_run


def test_the_same_effect_in_both_is_no_difference(side):
    """Parameters that agree within their errors count as the same."""
    assert differences_between(side(1, 3), side(2, 3)).are_none


@pytest.mark.parametrize(("times", "is_none"), [(1.15, True), (1.25, False)])
def test_a_fifth_of_an_effect_is_no_difference(side, times, is_none):
    """Sensors of one kind differ by so much: 15 % more is the same, 25 % more is not."""
    assert differences_between(with_drift(side(1, 3), times), side(2, 3)).are_none == is_none


def test_other_parameters_are_told_with_their_energy(side):
    """Twice a drift is one of other parameters: its energy is the square of what is missing of it."""
    own = side(2, 3)
    found = differences_between(with_drift(side(1, 3), 2), own)
    (pair,) = found.other_parameters
    assert (pair.recording.effect, found.missing, found.surplus) == ("temperature_drift", (), ())
    part = (6 / 3 - 1) ** 2
    assert found.energy == pytest.approx(part * own.gap.size.before**2, rel=0.2)


def in_two(side):
    """Return a side whose drift was found as two causes, one of an axis and one of the others."""
    (cause,) = side.gap.causes
    parts = [
        replace(cause, share=cause.share / 2, fitted=replace(cause.fitted, contributions=contributions))
        for contributions in (cause.fitted.contributions[:1], cause.fitted.contributions[1:])
    ]
    return replace(side, gap=replace(side.gap, causes=tuple(parts)))


@pytest.mark.parametrize("both", [False, True])
def test_an_effect_in_two_shapes_is_compared_as_one(side, both):
    """A drift that took two causes is the same as one of the same size, and of other parameters beside twice of it."""
    own = in_two(side(2, 3))
    same, twice = ((in_two if both else lambda one: one)(with_drift(side(1, 3), times)) for times in (1, 2))
    assert differences_between(same, own).are_none
    found = differences_between(twice, own)
    assert len(found.other_parameters) == 1 + both and found.surplus == ()
    assert len(found.missing) == 1 - both  # that the mend adds beside the other
    assert found.energy == pytest.approx(own.gap.size.before**2, rel=0.2)


def test_the_same_effect_elsewhere_is_another(side):
    """A drift of sensor 3 is surplus, that of sensor 2 missing."""
    found = differences_between(with_drift(side(1, 3), sensor=3), side(2, 3))
    assert [one.sensors for one in found.missing] == [(2,)] and [one.sensors for one in found.surplus] == [(3,)]


def test_other_noise_is_told_for_every_axis(side):
    """Noise of 1.5 times that of the simulation: its energy is that beyond the quieter side, in its floors."""
    found = differences_between(side(1), side(2, 0, 1.5))
    assert [one.differs for one in found.noise] == [True] * 12 + [False]
    assert found.energy == pytest.approx(12 / 13 * (1.5**2 - 1), rel=0.1)
    assert np.sqrt(found.energy) == pytest.approx(1.07, rel=0.05)
