"""A search from one start: what may come beside what was accepted."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.gap import diagnose
from tam_calibration.gap.looking import Looking


def switched(made, times, row=4, size=15e-9):
    """Return the run with an offset of one axis that changes sides at each of the times."""
    side = 1.0 - 2.0 * (np.searchsorted(times, made.recording.time_s) % 2)
    return made.with_row(row, size * side)


@pytest.mark.parametrize("times", [[25.0], [20.0, 38.0], [12.0, 30.0, 44.0]])
def test_up_to_three_jumps_are_jumps(run, times):
    """One, on and off, and three."""
    made = switched(run(600), times)
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "explained"
    assert {(cause.fitted.effect, cause.sensors) for cause in gap.causes} == {("bias_jump", (2,))}


def test_what_comes_and_goes_is_no_jump(run):
    """A loose contact that changes sides eight times is none of the library, and its sensor is told."""
    made = switched(run(600), [5.0, 11.0, 19.0, 24.0, 33.0, 40.0, 46.0, 55.0])
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "unexplained"
    assert (gap.where.sensors, gap.where.axes) == ((2,), ("y",))


def test_a_product_of_two_axes_is_no_loop(run):
    """What an axis feels across it is neither its hysteresis nor, together with that, its nonlinearity."""
    made = run(900)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    x, y, z = field.T / np.linalg.norm(field, axis=1)
    made = made.with_row(8, 20e-9 * x * y * (1 + 0.5 * z))
    gap = diagnose(made.recording, made.array)
    assert gap.verdict == "unexplained"
    assert (gap.where.sensors, gap.where.axes) == ((3,), ("z",))


def test_what_weight_moves_is_told_as_unexplained(run):
    """A loose magnet that rolls with the tilt is neither noise nor an arm that bends."""
    made = run(900)
    up = Rotation.from_quat(made.recording.attitude).inv().apply([0.0, 0.0, 1.0])
    made = made.with_row(4, 15e-9 * np.tanh(8 * (up[:, 0] + 0.3)))
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (2,))


def test_what_strikes_often_is_no_outlier(run):
    """Wrong readings in one sample of twelve are more than outliers."""
    made = run(900)
    generator = np.random.default_rng(5)
    hit = generator.random(900) < 1 / 12
    made = made.with_row(4, np.where(hit, 60e-9 * generator.choice([-1.0, 1.0], 900), 0.0))
    gap = diagnose(made.recording, made.array)
    assert (gap.verdict, gap.where.sensors) == ("unexplained", (2,))


@pytest.mark.parametrize(("next_best", "kept"), [(["skew"], ["heading", "skew"]), (["jump", "tone"], ["heading"])])
def test_where_a_cause_does_not_hold_the_search_goes_on_without_it(monkeypatch, next_best, kept):
    """Beside what holds, the next best comes in place of what does not; nothing is given up for it."""
    known = {name: SimpleNamespace(accepted=SimpleNamespace(effect=name)) for name in ("heading", "step", *next_best)}
    passed_over = []

    def forward(self, steps, first, without):
        passed_over.append(set(without))
        return [*steps, *(known[name] for name in next_best)]

    monkeypatch.setattr(Looking, "_forward", forward)
    monkeypatch.setattr(Looking, "_holding", lambda self, steps: [one for one in steps if one.accepted.effect in kept])
    held = object.__new__(Looking)._beside_held([known["heading"], known["step"]])
    assert [one.accepted.effect for one in held] == kept and passed_over[0] == {"step"}
