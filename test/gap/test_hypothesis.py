"""The best form of one hypothesis."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from tam_calibration.effects.courses import Flexure, GeomagneticDrift, TemperatureDrift
from tam_calibration.effects.curves import Nonlinearity
from tam_calibration.effects.states import BiasJump
from tam_calibration.gap.hypothesis import Hypothesis, best_form, places_of, refined
from tam_calibration.gap.regression import Selection
from tam_calibration.model.fitted_effect import SCALAR

TIME_CONSTANT_S = 3.3


def followed(recording):
    """Return the temperature that a sensor has which follows with a lag, by an integrator of its own."""

    def rate(time, state):
        return (np.interp(time, recording.time_s, recording.temperature_C) - state) / TIME_CONSTANT_S

    time = recording.time_s
    solved = solve_ivp(rate, (time[0], time[-1]), recording.temperature_C[:1], t_eval=time, max_step=0.05, rtol=1e-8)
    return solved.y[0]


@pytest.fixture(scope="module")
def drifting(run):
    """Return a run in which the x axis of sensor 2 drifts by 4 nT/K with a lag."""
    made = run(600)
    return made.with_row(3, 4e-9 * (followed(made.recording) - 20))


@pytest.fixture(scope="module")
def base(drifting):
    """Return its calibration."""
    return drifting.model().base()


def test_the_best_form_stands_where_the_effect_was_planted(base):
    """The drift is in one axis, and what it explains is nearly all of the excess."""
    form = best_form(base, TemperatureDrift())
    assert places_of(form) == [(1, 0)]
    assert form.selection.gain > 0.9 * (base.energy - base.channels.count)
    assert form.shape in form.tried and form.selection.delta_bic > 100


def test_a_refined_shape_reaches_the_true_time_constant(base):
    """Between the shapes that were tried, and no worse than the best of these."""
    form = best_form(base, TemperatureDrift())
    assert all(abs(shape["time_constant_s"] / TIME_CONSTANT_S - 1) > 0.1 for shape in form.tried)
    found = refined(base, form)
    assert found.shape["time_constant_s"] == pytest.approx(TIME_CONSTANT_S, rel=0.05)
    assert found.shape["reference_C"] == form.shape["reference_C"]
    assert found.selection.gain > form.selection.gain and found.selection.delta_bic > form.selection.delta_bic


def test_a_shape_without_choice_stays(base):
    """What was tried in one shape only is not refined."""
    form = best_form(base, Nonlinearity())
    assert refined(base, form).shape == form.shape


def test_without_a_scalar_no_effect_stands_in_it(run):
    """The row of the intensity is for what belongs to the site, where the intensity is only taken for constant."""
    for has_scalar in (True, False):
        made = run(400, has_scalar=has_scalar)
        time = made.recording.time_s
        field = made.errors.restore(made.recording.readings_T).mean(axis=1)
        grown = field / np.linalg.norm(field, axis=1)[:, None] * np.where(time > 30, 20e-9, 0)[:, None]
        added = np.zeros((400, 13))
        added[:, :-1] = np.einsum("kij,nj->nki", made.errors.matrix, grown).reshape(400, -1)
        base = made.with_added(added).model().base()
        jump = best_form(base, BiasJump(), times=((30.0,),))
        drift = best_form(base, GeomagneticDrift())
        assert (SCALAR in {sensor for sensor, _ in places_of(jump)}) == has_scalar
        assert places_of(drift) == [(SCALAR, None)] and drift.selection.delta_bic > 50


def test_nothing_visible_is_no_form(run):
    """An array whose attitude never changes shows no flexure beside its biases."""
    made = run(300)
    base = made.model().base()
    covariates = base.channels.covariates
    still = np.tile([0.0, 0.0, 0.0, 1.0], (300, 1))
    object.__setattr__(covariates, "attitude", still)
    form = best_form(base, Flexure())
    assert form is None or form.selection.delta_bic < 0


def test_a_parameter_that_was_never_changed_was_not_searched():
    """Nor one that the shape does not have."""
    tried = ({"at_s": 2.0, "reference_C": 20.0}, {"at_s": 1.0, "reference_C": 20.0}, {"other": 1.0})
    assert Hypothesis(Flexure(), tried[0], (), Selection((), 0.0, 0, 0.0), tried).searched == {"at_s": [1.0, 2.0]}


def test_an_exact_shape_is_not_refined(run):
    """The time of a jump is that of a law."""
    made = run(300)
    base = made.with_row(4, 20e-9 * (made.recording.time_s > 9)).model().base()
    form = best_form(base, BiasJump(), times=((9.0,),))
    assert refined(base, form) is form
