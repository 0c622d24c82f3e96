"""The causes of a law: the table holds every effect, and agrees with the laws and courses that exist."""

import runpy
from pathlib import Path

import pytest

from tam_calibration.effects.library import installed_effects
from tam_calibration.gap.laws.law import CAUSES, Signature, agrees, causes_of, makes, may_make

ROOT = Path(__file__).parents[3]
LAWS = {"offset", "gain", "rate", "own_field", "attitude", "noise", "samples"}
COURSES = {"constant", "step", "episodes", "slow", "tone", "channel", "motion", "random"}


def law(name, course, sensors=(2,), places=None, follows=None):
    """Return a law."""
    return Signature(name, course, sensors, ("x",), 0.9, places or (sensors,), follows, (), 100.0)


def test_every_effect_of_the_library_has_an_entry():
    """An effect without a signature could never be held against a law."""
    assert set(installed_effects()) <= {cause.name for cause in CAUSES}


@pytest.mark.parametrize("cause", CAUSES, ids=lambda cause: cause.name)
def test_entries_use_the_words_of_the_interface(cause):
    """Laws and courses are those of the JSON, and each cause says how to prove and what to do."""
    assert set(cause.law) <= LAWS
    assert set(cause.course) <= COURSES
    assert cause.title and cause.physics and cause.proof and cause.remedy


def test_the_channel_that_a_law_follows_decides():
    """A current that an offset follows leaves the causes of that current only."""
    assert [one.name for one in causes_of(law("offset", "channel", follows="current"))] == ["current_interference"]


def test_the_places_of_a_law_count():
    """What may sit in the scalar may be a cause of the scalar."""
    drift = law("offset", "slow", ("scalar",), (("scalar",), (1, 2, 3, 4)))
    assert "geomagnetic_drift" in {one.name for one in causes_of(drift)}
    assert "geomagnetic_drift" not in {one.name for one in causes_of(law("offset", "slow"))}


@pytest.mark.parametrize(
    ("effect", "found", "expected"),
    [
        ("temperature_drift", law("offset", "channel", follows="temperature"), (True, True, True)),
        ("current_interference", law("offset", "channel", follows="temperature"), (True, False, False)),
        ("platform_field", law("offset", "channel", (1, 2, 3, 4), follows="actuator_rudder"), (True, True, True)),
        ("bias_jump", law("offset", "slow"), (True, True, False)),
        ("scale_step", law("offset", "step"), (False, False, False)),
        ("somebody_elses", law("gain", "motion"), (True, True, True)),
    ],
)
def test_an_effect_makes_a_law_by_what_it_does_to_a_reading(effect, found, expected):
    """A course may look like another one, but what follows a recorded channel is made by an effect of that channel."""
    assert (makes(effect, found), may_make(effect, found), agrees(effect, found)) == expected


@pytest.mark.parametrize(
    ("effect", "found", "expected"),
    [
        ("hysteresis", law("offset", "slow"), ("own_field", "motion", "motion")),
        ("ringing", law("noise", "episodes"), ("rate", "constant", None)),
        ("ringing", law("offset", "slow"), ("rate", "constant", None)),
        ("ringing", law("offset", "tone", follows="1 Hz"), ("offset", "tone", "1 Hz")),
        ("temperature_drift", law("gain", "slow"), ("gain", "channel", "temperature")),
        ("bias_jump", law("offset", "episodes"), ("offset", "episodes", None)),
        ("noise_excess", law("noise", "random"), ("noise", "random", None)),
        ("somebody_elses", law("gain", "slow"), ("gain", "slow", None)),
    ],
)
def test_the_law_of_a_cause_is_its_own(effect, found, expected):
    """A free course that imitates it, or noise, is not stated beside the cause; what the cause may be stays."""
    made = found.as_made_by(effect)
    assert (made.law, made.course, made.follows) == expected


def test_the_page_is_that_of_the_table():
    """After a change of the table, run ``python docs/list_causes.py``."""
    written = runpy.run_path(str(ROOT / "docs" / "list_causes.py"))["page"]()
    assert (ROOT / "docs" / "reference" / "causes.md").read_text(encoding="utf-8") == written
