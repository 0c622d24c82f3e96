"""Functions without physics find what no effect of the library is, and nothing in noise."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.gap.hypotheses import evidence_of, rivals
from tam_calibration.gap.search import best_form, places_of
from tam_calibration.gap.unknown import (
    FunctionOfDirection,
    FunctionOfNeighbours,
    FunctionOfRate,
    FunctionOfTilt,
    FunctionOfTime,
)


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
        situation, misfit = made.channels().situation, made.channels().misfit
        names = {term.name for term in FunctionOfTime().terms(situation, {})}
        assert len(names) == bands
        spans = [shape["samples"] for shape in FunctionOfNeighbours().shapes(situation, misfit)]
        assert max(spans) * 8 <= samples


def test_neighbours_leave_the_sample_itself_out(run):
    """A shift of one sample is in the means of its neighbours, not in its own."""
    made = run(200)
    effect = FunctionOfNeighbours()
    misfit = made.with_row(4, np.where(np.arange(200) == 100, 1e-6, 0.0)).channels().misfit
    list(effect.shapes(misfit.situation, misfit))
    effect._shift = np.where(np.arange(200)[:, None] == 100, 1e-6, 0.0) * (np.arange(13) == 4)
    effect._shift[:, 5] = 1e-9
    terms = {term.axis: term.features[:, 0] for term in effect.terms(misfit.situation, {"samples": 4.0})}
    assert 1 not in terms  # it shares nothing with its neighbours
    assert terms[2][100] == pytest.approx(1e-9) and terms[2][0] == pytest.approx(0.5e-9)


def test_the_tilt_needs_the_attitude(run):
    """Without an attitude nothing is said of it, also where something follows it."""
    made = run(700)
    moved = made.with_row(7, disturbance("tilt", made))
    blind = replace(moved, recording=replace(moved.recording, attitude=None))
    assert "function_of_tilt" in {one.effect for one in rivals(moved.model().base())}
    assert "function_of_tilt" not in {one.effect for one in rivals(blind.model().base())}
