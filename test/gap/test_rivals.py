"""Changes that are abrupt, against what wanders."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.core.harmonics import harmonics
from tam_calibration.effects.grades import NOTABLE
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypothesis import best_form, given_form, places_of
from tam_calibration.gap.rivals import (
    SHARPEST,
    FunctionOfDirection,
    FunctionOfNeighbours,
    FunctionOfRate,
    FunctionOfTilt,
    FunctionOfTime,
    surrogate_test_of_change,
)
from tam_calibration.gap.size import evidence_of, rivals
from tam_calibration.model.fitted_effect import Contribution, FittedEffect


def wandering(time_s, swings, seed):
    """Return a smooth course of unit variance with so many swings."""
    generator = np.random.default_rng(seed)
    phase = np.pi * (time_s - time_s[0]) / np.ptp(time_s)
    course = sum(generator.normal() * np.cos(order * phase) for order in range(1, swings + 1))
    return (course - course.mean()) / course.std()


def surrogate_test(made, effect):
    """Return how the changes of an effect's best form, if any, stand, and whether a smooth course says more."""
    base = made.model().base()
    form = best_form(base, effect_named(effect))
    return form and surrogate_test_of_change(base, form, form.effect.always(form.shape), form.selection.delta_bic)


def is_promising(made, effect):
    """Whether the changes may be the first of several."""
    found, wanders = surrogate_test(made, effect) or (None, True)
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
        assert surrogate_test(made.with_row(4, row), "bias_jump")[0].ratio > SHARPEST


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
    found, _ = surrogate_test(made, "gain_switching")
    assert found.largest == 0 and found.gain > 100


def step_beside(made, size_T, course_T):
    """Return how a step of so much after half a minute stands beside a course."""
    base = made.with_row(4, np.where(made.recording.time_s > 30, size_T, 0.0) + course_T).model().base()
    part = Contribution(1, 1, "offset", {"offset": size_T})
    form = given_form(base, effect_named("bias_jump"), FittedEffect("bias_jump", {"time_s": 30.0}, (part,)))
    return surrogate_test_of_change(base, form, form.effect.always(form.shape), form.selection.delta_bic)


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
    found, _ = surrogate_test(made.with_row(4, steps), "bias_jump")
    assert found.ratio > 100
    assert 1 / found.rank - 1 in (43, 44, 45, 46)


def evidence(base, effect):
    """Return the evidence for an effect; minus infinity where nothing is visible."""
    form = best_form(base, effect)
    return (-np.inf, []) if form is None else (evidence_of(base, form).delta_bic, places_of(form))


def disturbance(kind, made):
    """Return 10 nT of a kind in one row."""
    time, generator = made.recording.time_s, np.random.default_rng(3)
    field = made.errors.restore(made.recording.readings_T).mean(axis=1)
    x, y, z = (field / np.linalg.norm(field, axis=1)[:, None]).T
    if kind == "time":
        return 10e-9 * np.exp(-(((time - 35) / 8) ** 2))
    if kind == "direction":
        return 10e-9 * np.tanh(3 * x * y) * z
    if kind == "tilt":
        up = Rotation.from_quat(made.recording.attitude).inv().apply([0.0, 0.0, 1.0])
        return 10e-9 * np.tanh(2 * up[:, 0]) * up[:, 1]
    if kind == "rate":
        return 10e-9 * np.gradient(x, time) * np.gradient(time)[0] * 60
    return 10e-9 * np.convolve(generator.normal(size=len(time) + 8), np.ones(9) / 3, mode="valid")


KINDS = {
    "time": FunctionOfTime,
    "direction": FunctionOfDirection,
    "tilt": FunctionOfTilt,
    "rate": FunctionOfRate,
    "neighbours": FunctionOfNeighbours,
}


@pytest.mark.parametrize("kind", KINDS)
def test_each_finds_its_kind_in_its_row(run, kind):
    """The evidence is strong, in the axis in which it was planted."""
    made = run(700)
    base = made.with_row(7, disturbance(kind, made)).model().base()
    delta_bic, places = evidence(base, KINDS[kind]())
    assert delta_bic > 100 and (2, 1) in places


@pytest.mark.parametrize("has_scalar", [True, False])
def test_noise_has_no_rivals(run, has_scalar):
    """In sixteen clean runs none has evidence that counts."""
    for seed in range(16):
        base = run(400, has_scalar=has_scalar, seed=seed).model().base()
        assert all(one.delta_bic < 12 for one in rivals(base))


def test_short_runs_have_few_cosines(run):
    """No more orders than eight samples each allow, and spans that fit in the run."""
    for samples, bands in ((20, 1), (40, 2), (300, 5)):
        made = run(samples)
        covariates, residuals = made.channels().covariates, made.channels().residuals
        names = {term.name for term in FunctionOfTime().terms(covariates, {})}
        assert len(names) == bands
        spans = [shape["samples"] for shape in FunctionOfNeighbours().shapes(covariates, residuals)]
        assert max(spans) * 8 <= samples


def test_neighbours_leave_the_sample_itself_out(run):
    """A shift of one sample is in the means of its neighbours, not in its own."""
    made = run(200)
    effect = FunctionOfNeighbours()
    residuals = made.with_row(4, np.where(np.arange(200) == 100, 1e-6, 0.0)).channels().residuals
    list(effect.shapes(residuals.covariates, residuals))
    effect._shift = np.where(np.arange(200)[:, None] == 100, 1e-6, 0.0) * (np.arange(13) == 4)
    effect._shift[:, 5] = 1e-9
    terms = {term.axis: term.features[:, 0] for term in effect.terms(residuals.covariates, {"samples": 4.0})}
    assert 1 not in terms  # it shares nothing with its neighbours
    assert terms[2][100] == pytest.approx(1e-9) and terms[2][0] == pytest.approx(0.5e-9)


def test_the_tilt_needs_the_attitude(run):
    """Without an attitude nothing is said of it, also where something follows it."""
    made = run(700)
    moved = made.with_row(7, disturbance("tilt", made))
    blind = replace(moved, recording=replace(moved.recording, attitude=None))
    assert "function_of_tilt" in {one.effect for one in rivals(moved.model().base())}
    assert "function_of_tilt" not in {one.effect for one in rivals(blind.model().base())}


def test_functions_of_direction_are_harmonics_of_their_degree(run):
    """Those of degree 2 to 4 span the spherical harmonics of that degree, and nothing else; 2 not of the scalar."""
    covariates = run(200).channels().covariates
    direction = covariates.field_T / np.linalg.norm(covariates.field_T, axis=1, keepdims=True)
    all_harmonics = harmonics(direction, 4)
    terms = FunctionOfDirection().terms(covariates, {})
    for degree in (2, 3, 4):
        own = [term for term in terms if term.name == f"degree {degree}"]
        assert len(own) == covariates.scalar_row + (degree > 2)
        expected = all_harmonics[:, degree**2 : (degree + 1) ** 2]
        found = own[0].features
        assert found.shape == expected.shape and np.linalg.matrix_rank(found) == 2 * degree + 1
        left = found - expected @ np.linalg.lstsq(expected, found)[0]
        assert np.abs(left).max() < 1e-9


def test_what_is_free_in_time_says_so():
    """Functions of time and of neighbours: on samples that are left out in blocks they say nothing."""
    kinds = (FunctionOfTime, FunctionOfDirection, FunctionOfTilt, FunctionOfRate, FunctionOfNeighbours)
    assert [kind.is_free_in_time for kind in kinds] == [True, False, False, False, True]


def test_what_goes_slowly_from_one_end_to_the_other_is_no_step(run):
    """The slowest course that there is, half a period over the run."""
    made = run(900)
    assert not is_promising(made.with_row(4, 10e-9 * wandering(made.recording.time_s, 1, 0)), "bias_jump")
