"""Which two explanations are so close that another recording must tell them apart."""

from types import SimpleNamespace

import pytest

from tam_calibration.gap.next_recording import _is_close, close_pair
from tam_calibration.model.fitted_effect import ALL


@pytest.mark.parametrize(
    ("evidences", "is_open"),
    [((20.0, 100.0, 88.5), True), ((20.0, 100.0, 87.5), False), ((11.0, 13.0), False), ((100.0,), False)],
)
def test_two_effects_that_explain_alike_are_an_open_question(evidences, is_open):
    """Where the verdict names no cause: the two best, within odds of 400 to one, and each beyond them."""
    weighed = tuple(SimpleNamespace(effect=str(one), delta_bic=one) for one in evidences)
    found = SimpleNamespace(weighed=weighed, steps=())
    assert close_pair(found, "unexplained", ()) == (("100.0", "88.5") if is_open else None)


def test_a_verdict_without_causes_to_doubt_has_no_question():
    """What no gap has weighed is no rival of anything."""
    weighed = tuple(SimpleNamespace(effect=name, delta_bic=100.0) for name in "ab")
    assert close_pair(SimpleNamespace(weighed=weighed, steps=()), "no_gap", ()) is None


@pytest.mark.parametrize(
    ("here", "there", "evidence", "is_certain", "is_close"),
    [
        ([(1, 0)], [(1, 2)], 88.5, False, True),
        ([(1, 0)], [(1, 0), (2, 0)], 87.5, False, False),
        ([(1, 0)], [(2, 0)], 99.0, False, False),
        ([(1, 0)], [(ALL, None)], 99.0, False, True),
        ([(ALL, None)], [(2, 0)], 99.0, False, True),
        ([(1, 0)], [(1, 0)], 99.0, True, False),
    ],
)
def test_a_rival_is_close_at_the_same_sensors(monkeypatch, here, there, evidence, is_certain, is_close):
    """What is of all sensors is at each; a cause that is certain has no rival."""
    monkeypatch.setattr("tam_calibration.gap.next_recording.places_of", lambda form: form)
    accepted = SimpleNamespace(form=here, delta_bic=100.0, is_certain=is_certain)
    assert _is_close(accepted, SimpleNamespace(form=there, delta_bic=evidence)) == is_close
