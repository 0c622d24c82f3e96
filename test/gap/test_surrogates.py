"""How a form stands among its surrogates."""

from copy import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.effects.library import effect_named
from tam_calibration.gap.hypothesis import best_form, restricted
from tam_calibration.gap.surrogates import SurrogateTest, _moved, _Shifted, surrogate_test_of


def test_rank_and_ratio_are_among_all():
    """The form itself is one of those that explain as much."""
    surrogate_test = SurrogateTest.among(30.0, np.array([10.0, 31.0, 5.0]))
    assert (surrogate_test.largest, surrogate_test.rank) == (31.0, 0.5)
    assert surrogate_test.ratio == pytest.approx(30 / 31)


def test_without_surrogates_nothing_is_larger():
    """The ratio is then the gain, and the rank that of one."""
    surrogate_test = SurrogateTest.among(30.0, np.zeros(0))
    assert (surrogate_test.largest, surrogate_test.rank, surrogate_test.ratio) == (0.0, 1.0, 30.0)


def slow(count, seed):
    """Return a slow course of time, of unit variance, that follows nothing."""
    walk = np.cumsum(np.random.default_rng(seed).normal(size=count))
    return (walk - walk.mean()) / walk.std()


def surrogate_test(made, effect):
    """Return how an effect's best form stands in the residual of a run."""
    base = made.model().base()
    return surrogate_test_of(base, best_form(base, effect_named(effect)))


def of_residual(base, differential, common):
    """Return the base of other whitened residuals of the same samples."""
    channels = base.channels
    residual_T = np.divide(common, np.sqrt(channels.precision), out=np.zeros_like(common), where=channels.precision > 0)
    other = copy(base)
    other.channels = replace(channels, differential=differential, intensity_residual_T=residual_T)
    other._score = np.concatenate([other.channels.score(design) for design in other.designs])
    other.step = other.inverse @ other._score
    other.energy = other.channels.energy - float(other._score @ other.step)
    return other


def test_moved_residuals_are_those_of_shifted_channels(run):
    """All shifts at once, by Fourier transform, explain what each channel rolled by hand does, either way round."""
    made = run(400)
    made = made.with_row(4, 20e-9 * slow(400, 1))
    base = made.model().base()
    form = best_form(base, effect_named("hysteresis"))
    own = np.array([explained for explained, _ in _moved(base, form)])
    differential, common = base.channels.taken_residual
    shift = int(np.linspace(20, 380, 150)[0])
    rolled = of_residual(base, np.roll(differential, shift, axis=0), np.roll(common, shift))
    turned = of_residual(base, np.roll(differential[::-1], shift + 1, axis=0), np.roll(common[::-1], shift + 1))
    by_hand = [one.project(base.channels.design(form.terms)).gain()[0] for one in (rolled, turned)]
    assert_allclose([own[0], own[len(own) // 2]], by_hand, rtol=1e-6)


def test_moved_residuals_of_atoms_that_act_on_several_rows(run):
    """Their scores at a shift are those of the channels rolled by hand."""
    base = run(400).model().base()
    form = best_form(base, effect_named("platform_field"))
    design = base.channels.design(base.channels.terms(form.effect, form.shape))
    assert design.rows.ndim == 2
    differential, common = base.channels.taken_residual
    rolled = of_residual(base, np.roll(differential, 20, axis=0), np.roll(common, 20))
    own = _Shifted(base, differential, common).scores(design)[:, 0]
    by_hand = rolled.channels.score(design)
    assert_allclose(own, by_hand, rtol=1e-6, atol=1e-9 * np.abs(by_hand).max())


@pytest.mark.parametrize(("effect", "row"), [("temperature_drift", 4), ("current_interference", 1), ("time_skew", 3)])
def test_a_slow_course_that_follows_nothing_stands_among_its_surrogates(run, effect, row):
    """Channel and motion explain a part of any slow course, and so do those like them."""
    made = run(900)
    found = surrogate_test(made.with_row(row, 10e-9 * slow(900, 5)), effect)
    assert found.gain > 12
    assert found.ratio < 1.1


def test_what_follows_the_temperature_stands_above_all_channels_like_it(run):
    """An axis that drifts with the recorded temperature, beside a slow course as large in another sensor."""
    made = run(900)
    change = made.recording.temperature_C - made.recording.temperature_C.mean()
    made = made.with_row(4, 5e-9 * change).with_row(8, 10e-9 * slow(900, 7))
    base = made.model().base()
    own = restricted(base, best_form(base, effect_named("temperature_drift")), 1)
    assert surrogate_test_of(base, own).rank < 0.03


def test_a_tone_stands_above_other_frequencies(run):
    """Mains at an alias."""
    made = run(900)
    found = surrogate_test(
        made.with_row(4, 3e-9 * np.sin(2 * np.pi * 4.1 * made.recording.time_s)), "periodic_interference"
    )
    assert found.ratio > 10


def test_an_intensity_that_drifts_stands_above_other_rows(run):
    """What the scalar magnetometer alone does not follow is told from an axis that drifts."""
    made, course = run(900), 5e-9 * slow(900, 3)
    assert surrogate_test(made.with_row(12, course), "geomagnetic_drift").ratio > 1.5
    assert surrogate_test(made.with_row(4, course), "geomagnetic_drift").ratio < 1


@pytest.mark.parametrize(("largest", "matched"), [(38_362.0, True), (20_000.0, False)])
def test_a_course_that_surrogates_nearly_have_is_matched(largest, matched):
    """A channel that only rises: any slow course explains as much."""
    assert SurrogateTest(39_349.0, largest, 0.02).is_matched is matched
