"""How much evidence settles a question."""

from types import SimpleNamespace

import pytest

from tam_calibration.gap.separation import Separation, long_enough


@pytest.mark.parametrize(("gained", "minutes"), [(9, 15), (18, 10), (33, 5), (0.1, 60)])
def test_a_recording_brings_twice_what_decides(gained, minutes):
    """Where five minutes bring so much evidence, twenty-four take so many; never more than an hour."""
    assert long_enough(gained, 5.0) == pytest.approx(minutes)


@pytest.mark.parametrize(("gained", "decides"), [(5, False), (9, True)])
def test_less_than_a_recording_can_bring_is_no_question(gained, decides):
    """Ten in all is too little, fourteen is enough."""
    first, second = (SimpleNamespace(effect=SimpleNamespace(name=name)) for name in ("time_skew", "flexure"))
    one = Separation(first, second, 5.0, gained, SimpleNamespace(words="turn it"), 60.0, ())
    assert ("no recording of an hour would tell them apart" in one.sentence) != decides
