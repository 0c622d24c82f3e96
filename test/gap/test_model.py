"""Calibration and effects are fitted together, to the joint solution."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import least_squares

from tam_calibration.effects.courses import TemperatureDrift
from tam_calibration.effects.effect import Finding
from tam_calibration.gap import model as module
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.model import Model
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.sensor_errors import SensorErrors

SLOPE_T_PER_K = 30e-9
DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 0.0, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 0.0}),),
)


@pytest.fixture(scope="module")
def drifting(run):
    """Return a run of two sensors in which an axis drifts by thirty times the noise for each kelvin."""
    made = run(150, 2)
    return made.with_row(3, SLOPE_T_PER_K * (made.recording.temperature_C - 20))


@pytest.fixture(scope="module")
def fitted(drifting, accepted):
    """Return its model with the drift."""
    return accepted(Model.nominal(drifting.recording, drifting.array), TemperatureDrift(), DRIFT)


def whitened(run, errors, slope):
    """Return the channels of a run with a drift taken off, from their definition: all that is in no field's image."""
    change = slope * (run.recording.temperature_C - 20)
    rows = (run.recording.readings_T - errors.bias_T).reshape(len(change), -1) - np.outer(change, np.eye(6)[3])
    weight = 1 / np.repeat(run.array.vector_noise_T, 3)
    stacked = weight[:, None] * errors.matrix.reshape(-1, 3)
    field = np.linalg.lstsq(stacked, (rows * weight).T, rcond=None)[0].T
    covariance = np.linalg.inv(stacked.T @ stacked)
    length = np.linalg.norm(field, axis=1)
    unit = field / length[:, None]
    deviation = np.sqrt(run.array.scalar_noise_T**2 + np.sum(unit @ covariance * unit, axis=1))
    return np.column_stack([rows * weight - field @ stacked.T, (run.recording.scalar_T - length) / deviation]).ravel()


def test_the_settled_model_is_the_joint_least_squares_solution(drifting, fitted):
    """Another solver, from the truth on, finds no lower sum of squares and the same coefficient."""
    unit = np.array([1e-2] * 9 + [1e-7] * 3)

    def errors_of(vector):
        change = vector.reshape(2, 12) * unit
        return SensorErrors.from_matrix(
            drifting.errors.matrix + change[:, :9].reshape(2, 3, 3), drifting.errors.bias_T + change[:, 9:]
        )

    def residual(vector):
        return whitened(drifting, errors_of(vector[:-1]), vector[-1] * 1e-9)

    found = least_squares(residual, np.append(np.zeros(24), SLOPE_T_PER_K / 1e-9), xtol=1e-12, ftol=1e-12)
    own = fitted.base().channels.energy
    assert own == pytest.approx(np.sum(whitened(drifting, fitted.errors, fitted.parts[0].values[0]) ** 2), rel=1e-6)
    assert own == pytest.approx(2 * found.cost, abs=0.05)
    assert fitted.parts[0].values[0] == pytest.approx(found.x[-1] * 1e-9, rel=1e-3)
    assert fitted.parts[0].values[0] == pytest.approx(SLOPE_T_PER_K, rel=0.02)


def test_nothing_is_left_to_gain_where_the_model_has_settled(fitted):
    """One more step gains less than a thousandth of a channel."""
    base = fitted.base()
    assert base.channels.energy - base.energy < 2e-3
    assert fitted.settled().base().channels.energy <= base.channels.energy


@pytest.mark.parametrize("start_T", [0.0, 3e-6, -3e-5])
def test_settling_never_climbs(monkeypatch, drifting, fitted, start_T):
    """From coefficients far off, each step that is taken lowers the energy or keeps it."""
    far = replace(fitted, parts=(replace(fitted.parts[0], values=np.array([start_T])),))
    energies = [far.base().channels.energy]
    downhill = Model._lower

    def recorded(model, base):
        moved = downhill(model, base)
        if moved is not None:
            energies.append(moved[1].channels.energy)
        return moved

    monkeypatch.setattr(Model, "_lower", recorded)
    far.settled()
    assert (np.diff(energies) <= 0).all() and len(energies) > 1


def test_a_gross_jump_is_fitted(run):
    """A sensor whose bias jumps by 60 µT, more than the field, in the middle of the run; no other row is named."""
    made = run(450)
    step = np.where(made.recording.time_s > 27.0, 60e-6, 0.0)
    (cause,) = judge(made.with_row(3, step).recording, made.array).gap.causes
    assert cause.fitted.shape["time_s"] == pytest.approx(27.0, abs=0.1)
    values = {(one.sensor, one.axis): one.values["offset"] for one in cause.fitted.contributions}
    assert cause.fitted.effect == "bias_jump" and values.pop((1, 0)) == pytest.approx(60e-6, abs=1e-9)
    assert_allclose(list(values.values()), 0, atol=1e-9)
    assert (cause.sensors, cause.axes) == ((2,), ("x",))


def test_a_clean_run_is_fitted_to_the_noise(run):
    """The nominal model of noise is noise, in the frame of the first sensor."""
    made = run(400)
    model = Model.nominal(made.recording, made.array)
    assert model.parts == () and model.is_counted.all()
    assert model.base().energy / model.base().channels.count == pytest.approx(1, abs=0.08)
    assert_allclose(model.errors.to_vector()[0, 9:], 0, atol=1e-12)
    assert_allclose(model.errors.bias_T, made.errors.bias_T, atol=3e-9)


def test_a_long_recording_is_searched_thinned_and_fitted_whole(monkeypatch, run):
    """With a stride the energy is that of every third sample; the fit to all samples is the one without stride."""
    made = run(900)
    whole = Model.nominal(made.recording, made.array)
    monkeypatch.setattr(module, "ENOUGH_SAMPLES", 400)
    thinned = Model.nominal(made.recording, made.array)
    assert (whole.stride, thinned.stride) == (1, 3)
    assert thinned.channels().count == 300 * 10
    third = Model(made.recording.take(slice(None, None, 3)), made.array, made.errors, made.intensity_T).settled()
    assert thinned.base().energy == pytest.approx(third.base().energy, rel=1e-4)
    again = thinned.of_all_samples()
    assert again.stride == 1 and again.of_all_samples() is again
    assert again.base().channels.energy == pytest.approx(whole.base().channels.energy, abs=0.01)


def test_findings_give_samples_up_and_widen_rows(run):
    """Samples that any finding flags do not count; variances add up."""
    made = run(200)
    model = made.model()
    flags = [np.arange(200) < 5, np.arange(200) == 100]
    variance = np.append(np.full(12, 1e-18), 0)
    effect = FittedEffect("outliers", {}, ())
    findings = tuple(Finding(effect, 1.0, 1, flagged, variance) for flagged in flags)
    found = replace(model, findings=findings)
    assert np.flatnonzero(~found.is_counted).tolist() == [0, 1, 2, 3, 4, 100]
    energy = (
        found.channels().energy_per_sample - found.channels().precision * found.channels().intensity_residual_T ** 2
    )
    before = (
        model.channels().energy_per_sample - model.channels().precision * model.channels().intensity_residual_T ** 2
    )
    assert_allclose(energy, before / 3, rtol=1e-6)
    assert model.accept(findings[0]).findings == findings[:1]


def test_the_signal_is_what_the_effects_add(fitted, drifting):
    """In one row, the coefficient times the temperature."""
    signal = fitted.signal()
    assert_allclose(signal[:, 3], fitted.parts[0].values[0] * (drifting.recording.temperature_C - 20), rtol=1e-9)
    assert not np.delete(signal, 3, axis=1).any()


def pushed(model, fall):
    """Return a settled model whose bias is off by so much that a step would lower the energy by that."""
    for _ in range(3):
        base = model.base()
        model = model._stepped(base.step, base)

    def shifted(size_T):
        bias = model.errors.bias_T.copy()
        bias[1, 1] += size_T
        return replace(model, errors=replace(model.errors, bias_T=bias))

    return shifted(1e-10 * np.sqrt(fall / shifted(1e-10).base().fall))


@pytest.mark.parametrize(("part", "has_settled"), [(0.007, True), (0.014, False)])
def test_a_fit_that_a_step_would_better_by_a_hundredth_has_not_settled(run, part, has_settled):
    """It is held back by its bounds."""
    model = run(300, 2).model()
    assert pushed(model, part * model.base().channels.energy / (1 - part)).is_settled == has_settled


@pytest.mark.parametrize(("fall", "has_settled"), [(0.7e-5, True), (1.4e-5, False)])
def test_a_step_that_promises_a_part_of_a_channel_is_taken(run, fall, has_settled):
    """Less is far below any evidence."""
    model = pushed(run(300, 2).model(), fall)
    assert (model.settled() is model) == has_settled
