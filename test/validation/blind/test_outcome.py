"""An answer held against its key."""

import pytest

from tam_validation.blind.outcome import Outcome


def outcome(kind, truth, answer):
    """Return the outcome of a case with a cause, or none, that was answered so."""
    effects = [{"effect": name, "visible_gap": 1.0, "sensors": [1], "axes": []} for name in truth]
    return Outcome("case", {"kind": kind, "effects": effects, "withheld_channel": "temperature"}, answer)


def answered(verdict, probability, told):
    """Return an answer with a verdict but no cause."""
    name = "no_gap" if verdict == "no_gap" else "none_of_these"
    return {"verdict": verdict, "probabilities": {name: probability}, "set_95": told}


@pytest.mark.parametrize(
    ("kind", "truth", "verdict", "is_true"),
    [
        ("clean", [], "no_gap", True),
        ("short", [], "no_gap", True),
        ("short", [], "unexplained", False),
        ("single", ["hysteresis"], "unexplained", False),
        ("single", ["hysteresis"], "no_gap", False),
        ("outside", ["stiction"], "unexplained", True),
        ("withheld", ["temperature_drift"], "unexplained", True),
        ("withheld", ["temperature_drift"], "no_gap", False),
    ],
)
def test_what_is_said_first_is_true_where_it_can_be_known(kind, truth, verdict, is_true):
    """Nothing where there is nothing, however few the samples; none of the effects where their channel is missing."""
    told = ["unknown"] if verdict == "unexplained" else ["no_gap"]
    one = outcome(kind, truth, answered(verdict, 0.8, told))
    assert one.first_forecast == (0.8, is_true)
    assert one.set_holds is is_true
