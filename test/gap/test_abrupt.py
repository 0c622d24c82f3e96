"""Changes that are abrupt, against what wanders."""

import numpy as np
import pytest

from tam_calibration.effects.fitted import Contribution, FittedEffect
from tam_calibration.effects.grades import NOTABLE
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.abrupt import SHARPEST, standing_of_change
from tam_calibration.gap.search import best_form, given_form


def wandering(time_s, swings, seed):
    """Return a smooth course of unit variance with so many swings."""
    generator = np.random.default_rng(seed)
    phase = np.pi * (time_s - time_s[0]) / np.ptp(time_s)
    course = sum(generator.normal() * np.cos(order * phase) for order in range(1, swings + 1))
    return (course - course.mean()) / course.std()


def standing(made, effect):
    """Return how the changes of an effect's best form, if any, stand, and whether a smooth course says more."""
    base = made.model().base()
    form = best_form(base, effect_named(effect))
    return form and standing_of_change(base, form, form.effect.always(form.shape), form.selection.delta_bic)


def is_promising(made, effect):
    """Whether the changes may be the first of several."""
    found, wanders = standing(made, effect) or (None, True)
    return not wanders or (found is not None and found.ratio > SHARPEST * NOTABLE)


@pytest.mark.parametrize("swings", [2, 5, 12])
@pytest.mark.parametrize("seed", range(3))
def test_what_wanders_is_no_step(run, swings, seed):
    """A bias, and a scale factor, that wander smoothly."""
    made = run(900)
    course = wandering(made.recording.time_s, swings, seed)
    assert not is_promising(made.with_row(4, 10e-9 * course), "bias_jump")
    assert not is_promising(made.with_row(4, 3e-4 * course * made.recording.readings_T[:, 1, 1]), "scale_step")


@pytest.mark.parametrize("ends", [(30.0, np.inf), (20.0, 41.0)])
def test_a_step_is_abrupt(run, ends):
    """For good or for a while, alone or beside what wanders."""
    made = run(900)
    time_s = made.recording.time_s
    jump = np.where((time_s > ends[0]) & (time_s < ends[1]), 15e-9, 0.0)
    drift = 4e-9 * wandering(time_s, 2, 1)
    for row in (jump, jump + drift):
        assert standing(made.with_row(4, row), "bias_jump")[0].ratio > SHARPEST


def test_many_steps_are_no_step(run):
    """A random walk by a step every six seconds."""
    made = run(900)
    walk = np.cumsum(np.random.default_rng(4).choice([-1.0, 1.0], 11))
    course = walk[np.minimum((made.recording.time_s / 6).astype(int), 10)]
    assert not is_promising(made.with_row(4, 10e-9 * course), "bias_jump")


def test_levels_at_the_same_times_are_more_of_the_same(run):
    """Two steps of unlike size are no course, though one step to and fro fits them badly."""
    made = run(900)
    time_s = made.recording.time_s
    level = np.where(time_s < 20, 0.0, np.where(time_s < 41, 20e-9, -14e-9))
    assert is_promising(made.with_row(4, level), "bias_jump")


def test_where_all_times_are_changes_there_is_no_other(run):
    """A gain that goes to and fro all the time stands alone."""
    made = run(900)
    is_on = (made.recording.time_s % 2.4) < 1.0
    made = made.with_row(4, np.where(is_on, 1e-3, 0.0) * made.recording.readings_T[:, 1, 1])
    found, _ = standing(made, "gain_switching")
    assert found.largest == 0 and found.gain > 100


def step_beside(made, size_T, course_T):
    """Return how a step of so much after half a minute stands beside a course."""
    base = made.with_row(4, np.where(made.recording.time_s > 30, size_T, 0.0) + course_T).model().base()
    part = Contribution(1, 1, "offset", {"offset": size_T})
    form = given_form(base, effect_named("bias_jump"), FittedEffect("bias_jump", {"time_s": 30.0}, (part,)))
    return standing_of_change(base, form, form.effect.always(form.shape), form.selection.delta_bic)


@pytest.mark.parametrize(("size_T", "low", "high"), [(2e-9, 4, 5), (2.7e-9, 8, 11)])
def test_beside_a_smooth_course_a_step_stands_as_it_does_without(run, size_T, low, high):
    """The course says more, and is taken off before steps are compared: that the second may be one is seen."""
    made = run(900)
    found, wanders = step_beside(made, size_T, 20e-9 * wandering(made.recording.time_s, 5, 1))
    assert wanders and low < found.ratio < high
    assert (found.ratio > SHARPEST * NOTABLE) == (size_T > 2.5e-9)


def test_steps_at_all_other_times_are_tried(run):
    """Of 64 times evenly over the record those within a twentieth of it of one of three steps are left out: 19 or 20.

    The third, of which the form says nothing, is taken for more of the same and does not stand against it.
    """
    made = run(900)
    time_s = made.recording.time_s
    steps = 1e-9 * (20 * (time_s > 12) - 35 * (time_s > 24) + 15 * (time_s > 45))
    found, _ = standing(made.with_row(4, steps), "bias_jump")
    assert found.ratio > 100
    assert 1 / found.rank - 1 in (43, 44, 45, 46)
