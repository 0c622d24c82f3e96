"""The noise that a diagnosis states, and what it says of a data sheet."""

from dataclasses import replace

import numpy as np
import pytest

from tam_calibration.effects.effect import Finding
from tam_calibration.gap import diagnose
from tam_calibration.gap.noise import recorded_noise, remarks_on, residual_of
from tam_calibration.model.array import Array
from tam_calibration.model.fitted_effect import FittedEffect


def test_the_residual_is_the_noise_as_it_is_mixed(run):
    """Of four sensors each keeps three quarters of the variance of its own noise and that of the others."""
    made = run(1000)
    residual_T, mixing = residual_of(made.model(), made.recording)
    assert residual_T.std(axis=0) == pytest.approx(np.full(12, 1e-9 * np.sqrt(0.75)), rel=0.1)
    assert np.diag(mixing) == pytest.approx(np.full(12, 0.75), abs=0.05)


@pytest.mark.parametrize("sensors", [1, 2, 4])
def test_the_noise_of_every_row(run, sensors):
    """As it was simulated, beside what the array states; the scalar is last, whatever the field drifts by."""
    made = run(1500, sensors)
    drifting = made.with_row(-1, 20e-9 * np.sin(0.05 * made.recording.time_s)) if sensors > 1 else made
    *axes, scalar = recorded_noise(drifting.model(), made.array)
    assert [one.level_T for one in axes] == pytest.approx([1e-9] * 3 * sensors, rel=0.15)
    assert (scalar.sensor, scalar.axis) == (0, "") and scalar.level_T == pytest.approx(2e-10, rel=0.15)
    assert [one.stated_T for one in (*axes, scalar)] == pytest.approx([1e-9] * 3 * sensors + [2e-10])


def test_no_scalar_and_no_sheet(run):
    """Then the last row is the last axis, and nothing is stated."""
    made = run(600, has_scalar=False)
    noise = recorded_noise(made.model(), Array(made.array.positions_m))
    assert (noise[-1].sensor, noise[-1].axis) == (4, "z") and np.isnan([one.stated_T for one in noise]).all()


def test_noise_that_is_a_cause_has_its_level(run):
    """Variances of sheet and cause add up, at the axis, the sensor or the scalar."""
    made = run(600)
    excess_T2 = 1e-18 * np.array([0, 9, 0, 0, 0, 0, 0, 0, 0, 16, 16, 16, 1])
    finding = Finding(FittedEffect("noise_excess", {}, ()), 100.0, 1, variance=excess_T2)
    noise = recorded_noise(made.model(findings=(finding,)), made.array)
    for one, excess in zip(noise, excess_T2, strict=True):
        if excess > 0:
            assert one.level_T == one.white_T == pytest.approx(np.sqrt(one.stated_T**2 + excess))
            assert one.level_error_T == pytest.approx(one.level_T / np.sqrt(1200))
    assert [one.level_T for one, excess in zip(noise, excess_T2, strict=True) if not excess] == pytest.approx(
        [1e-9] * 8, rel=0.3
    )


@pytest.fixture(scope="module")
def model(run):
    """Return the model of a clean run."""
    return run(1500).model()


def remarks(model, stated, is_determined=True):
    """Return the remarks on the noise of a model beside a sheet."""
    noise = recorded_noise(model, stated)
    return remarks_on(noise, stated, is_determined, model.recording.sample_count)


@pytest.mark.parametrize(
    ("factor", "said"),
    [(0.1, "0.1 nT, found "), (0.43, "0.43 nT, found "), (0.57, None), (1.75, None), (2.3, "2.3 nT, found ")],
)
def test_a_sheet_that_is_far_off_is_contradicted(model, factor, said):
    """Up to twice or half of the noise it may be right; where differences hold the motion it is not judged."""
    array = model.array
    stated = Array(array.positions_m, factor * array.vector_noise_T, array.scalar_noise_T)
    found = remarks(model, stated)
    assert len(found) == (0 if said is None else 4)
    assert all(one.startswith("The stated noise of sensor") and f"stated {said}" in one for one in found)
    assert remarks(model, stated, is_determined=False) == ()


@pytest.mark.parametrize(
    ("is_determined", "said"), [(True, "of sensor 4 are taken from the recording"), (False, "from the residual")]
)
def test_a_noise_that_is_not_stated_is_told(model, is_determined, said):
    """Nothing white can be called a gap then."""
    (remark,) = remarks(model, Array(model.array.positions_m), is_determined)
    assert remark.startswith("The noise is not stated") and "nothing white can be called a gap" in remark
    assert said in remark


def test_a_diagnosis_states_the_noise(run):
    """Of thirteen rows, that of the noisy scalar too; none without a verdict."""
    made = run(300)
    noisy = replace(made.recording, scalar_T=made.recording.scalar_T + np.random.default_rng(1).normal(0, 5e-9, 300))
    gap = diagnose(noisy, made.array)
    assert [cause.fitted.effect for cause in gap.causes] == ["noise_excess"]
    assert len(gap.noise) == 13 and gap.noise[-1].level_T == pytest.approx(5e-9, rel=0.1)
    assert diagnose(made.recording.take(slice(20)), made.array).noise == ()
