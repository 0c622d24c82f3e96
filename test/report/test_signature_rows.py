"""The laws of a gap in words."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.gap.laws.law import Course, Signature, causes_of
from tam_calibration.report.gap_plots import plot_course
from tam_calibration.report.gap_rows import causes_sentence, law_sentence

GAIN = Course(np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.004, 0.0]), np.full(3, 1e-4), "1")
OFFSET = Course(np.array([0.0, 1.0]), np.array([0.0, 3e-9]), np.full(2, 1e-10), "T")


def law(name, course, sensors=(3,), axes=("z",), **other):
    """Return a law of most of the gap."""
    known = {"places": (sensors,), "follows": None, "times_s": (), "curve": None} | other
    return Signature(name, course, sensors, axes, 0.93, evidence=100.0, **known)


@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
@pytest.mark.parametrize(
    ("stated", "words"),
    [
        (
            law("gain", "episodes", times_s=(3.0, 5.0, 8.0, 9.0), curve=GAIN),
            "Sensor 3, axis z: its gain, or what leaks into it, changes by 0.40 % in 2 episodes (from and until "
            "3.000 s, 5.000 s, 8.000 s, 9.000 s), 93 % of the gap. No recorded channel goes with it.",
        ),
        (
            law("offset", "channel", axes=("x", "y", "z"), follows="current", curve=OFFSET),
            "Sensor 3: its offset changes by 3.0 nT with the recorded current, 93 % of the gap.",
        ),
        (
            law("attitude", "motion", ("scalar",), (), places=(("scalar",), (1, 2, 3, 4))),
            "The scalar, or the field at all sensors alike: its error is a function of direction, 93 % of the gap.",
        ),
        (
            law("gain", "constant", (1, 2, 3, 4), ("x", "y", "z")),
            "All sensors: their gain, or what leaks into it, changes, the same throughout, 93 % of the gap.",
        ),
        (law("noise", "random"), "Sensor 3, axis z: its noise is larger, 93 % of the gap."),
        (law("noise", "episodes"), "Sensor 3, axis z: its noise is larger in episodes, 93 % of the gap."),
        (
            law("rate", "step"),
            "Sensor 3, axis z: its error goes with the field's rate of change in steps, 93 % of the gap.",
        ),
        (
            law("rate", "motion"),
            "Sensor 3, axis z: its error goes with the field's rate of change, most in fast turns, 93 % of the gap.",
        ),
        (
            law("attitude", "slow", ("scalar",), (), curve=OFFSET),
            "The scalar: its error is a function of direction that changes by 3.0 nT slowly, 93 % of the gap.",
        ),
        (
            law("attitude", "slow", (1, 2, 3, 4), ("x", "y", "z"), curve=OFFSET),
            "All sensors: the field differs between them, and changes by 3.0 nT slowly, 93 % of the gap.",
        ),
        (
            law("rate", "constant", (1, 2)),
            "Sensors 1 and 2, axis z: their error goes with the field's rate of change, the same throughout, 93 % of "
            "the gap.",
        ),
    ],
)
def test_a_law_in_a_sentence(stated, words, start_s):
    """Where, what, how much, when from the start of the recording on, its share, and what it goes with."""
    stated = replace(stated, times_s=tuple(start_s + time for time in stated.times_s))
    assert law_sentence(stated, SimpleNamespace(sensor_count=4, origin_s=start_s)) == words


def test_causes_are_listed_with_their_proof():
    """The likeliest first, and nothing where the table holds none."""
    words = causes_sentence(law("gain", "episodes"))
    assert words.startswith("Causes with this signature: ")
    assert "supply that sags (record the supply voltage of the sensor)" in words
    assert causes_sentence(law("samples", "channel")) == ""
    last = causes_of(law("gain", "episodes"))[-1]
    named = causes_sentence(law("gain", "episodes"), [last.name])
    assert named.startswith(f"Causes with this signature: {last.title} (")


def test_the_course_is_drawn_with_its_band():
    """One curve in per cent, and one band."""
    (axes,) = plot_course(GAIN).axes
    assert axes.lines[0].get_ydata().max() == pytest.approx(0.4)
    assert len(axes.collections) == 1
