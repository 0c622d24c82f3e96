"""From which sizes on a gap is one, and is explained."""

from types import SimpleNamespace

import numpy as np
import pytest

from tam_calibration.gap import diagnose
from tam_calibration.gap.conclude import verdict_on


def verdict(monkeypatch, steps, **size):
    """Return the verdict on a search that left nothing visible."""
    monkeypatch.setattr("tam_calibration.gap.conclude.open_part", lambda *models: 0.0)
    monkeypatch.setattr("tam_calibration.gap.conclude._is_open_elsewhere", lambda found: False)
    model = SimpleNamespace(base=lambda: None)
    found = SimpleNamespace(steps=steps, nominal=model, model=model, remaining=())
    return verdict_on(found, SimpleNamespace(after=0.05, **size), 1.0, is_noisier=True)


@pytest.mark.parametrize(("before", "found"), [(0.07, "no_gap"), (0.14, "unexplained")])
def test_a_tenth_of_the_noise_floor_is_a_gap(monkeypatch, before, found):
    """Less is none, however certain."""
    assert verdict(monkeypatch, (), before=before, closed=0.0) == found


@pytest.mark.parametrize(
    ("closed", "found"),
    [(0.18, "unexplained"), (0.35, "partly_explained"), (0.45, "partly_explained"), (0.8, "explained")],
)
def test_causes_close_a_quarter_of_a_gap_or_more_than_half(monkeypatch, closed, found):
    """Less than a quarter explains nothing, and from six tenths on nothing is open."""
    assert verdict(monkeypatch, ("a step",), before=1.0, closed=closed) == found


@pytest.mark.parametrize(("row", "found"), [(5, "explained"), (8, "partly_explained")])
def test_what_another_sensor_has_beside_a_cause_is_open(run, row, found):
    """A tone that runs away, which no function without physics is, beside a jump of sensor 2, there and in sensor 3."""
    made = run(900)
    time_s = made.recording.time_s
    runaway = 1.2e-9 * np.sin(2 * np.pi * (1 + 0.06 * time_s) * time_s)
    jump = np.where(time_s > 25, 30e-9, 0.0)
    gap = diagnose(made.with_row(4, jump).with_row(row, runaway).recording, made.array)
    assert [cause.fitted.effect for cause in gap.causes] == ["bias_jump"]
    assert gap.verdict == found
