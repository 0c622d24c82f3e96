"""Names held against the law of the gap: what cannot make it is not named, or is doubted."""

from dataclasses import dataclass, field

import pytest

from tam_calibration.gap.conclude import DOUBTED, with_doubt
from tam_calibration.gap.discipline import contradicted, doubted
from tam_calibration.gap.laws.law import Signature


@dataclass
class Accepted:
    """The evidence of a step, by its effect."""

    effect: str


@dataclass
class Step:
    """A step of a search."""

    accepted: Accepted


@dataclass
class Found:
    """A search as far as its names go."""

    names: tuple[str, ...]
    steps: list[Step] = field(init=False)

    def __post_init__(self):
        """Make the steps."""
        self.steps = [Step(Accepted(name)) for name in self.names]


def law(name, course, energy=0.95):
    """Return a law of sensor 2."""
    return Signature(name, course, (2,), ("x",), energy, ((2,),), None, (), 100.0)


@pytest.mark.parametrize(
    ("name", "found", "expected"),
    [
        ("temperature_drift", law("gain", "step"), ("temperature_drift",)),
        ("scale_step", law("gain", "step"), ()),
        ("hysteresis", law("offset", "random"), ()),
        ("timing_jitter", law("noise", "random"), ()),
        ("bias_jump", law("gain", "step", energy=0.5), ()),
    ],
)
def test_a_structured_law_of_most_of_the_gap_contradicts_other_names(name, found, expected):
    """A free course, noise, and a law of half the gap contradict nothing."""
    assert contradicted(Found((name,)), [found]) == expected


def test_a_name_that_does_not_make_the_law_is_doubted():
    """Whatever the course is, and not without a law."""
    assert doubted(Found(("hysteresis", "bias_jump")), [law("offset", "step")]) == ("hysteresis",)
    assert doubted(Found(("hysteresis",)), []) == ()


def test_what_a_doubted_cause_loses_goes_to_none_of_the_library():
    """The probabilities still add up to what they did."""
    chances = {"hysteresis": 0.95, "no_gap": 0.0, "none_of_these": 0.05}
    lowered = with_doubt(chances, ["hysteresis"])
    assert lowered["hysteresis"] == DOUBTED
    assert sum(lowered.values()) == pytest.approx(1.0)
    assert with_doubt(chances, []) == chances
