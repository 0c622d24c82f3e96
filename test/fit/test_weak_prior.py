"""Beside a prior that leaves errors open narrow turns are calibrated, with standard errors that hold."""

from dataclasses import replace

import numpy as np
import pytest
from narrow_turns import FINE, NOISE_T, WIDE, array_of, drawn, turned
from numpy.testing import assert_allclose

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.fit import calibrate
from tam_calibration.fit import maximum_a_posteriori as weak_prior
from tam_calibration.fit.ellipsoid import free_scale
from tam_calibration.fit.maximum_a_posteriori import (
    calibrate_with_weak_prior,
    is_weak,
    maximum_a_posteriori,
    prior_of_tolerances,
)
from tam_calibration.fit.prior import in_first_frame, prior_of
from tam_calibration.fit.problem import Known
from tam_calibration.model.data_sheet import ChangeRates, Tolerances
from tam_calibration.model.exceptions import InputError, Refused


def pulls(calibration, errors):
    """Return errors of the free parameters over their standard errors, and those of the principal combinations.

    Combinations that a convention fixes, such as the scale without a scalar, are left out.
    """
    free = calibration.standard_errors.ravel() > 0
    error = (calibration.errors.to_vector() - in_first_frame(errors)[0].to_vector()).ravel()[free]
    size = calibration.standard_errors.ravel()[free]
    variances, axes = np.linalg.eigh(calibration.covariance[np.ix_(free, free)] / np.outer(size, size))
    seen = variances > 1e-12
    return error / size, (axes.T @ (error / size))[seen] / np.sqrt(variances[seen])


def rms(values):
    """Return the root mean square of arrays of pulls."""
    return float(np.sqrt(np.mean(np.square(values))))


def test_a_narrow_turn_is_calibrated_beside_tolerances():
    """It is refused alone; beside them it is told what came from where, and what is still open."""
    rng = np.random.default_rng(1)
    errors = drawn(WIDE, 1, rng)
    narrow, array = turned(errors, 5, rng), array_of(WIDE, 1)
    with pytest.raises(InputError, match="do not determine"):
        calibrate(narrow, replace(array, tolerances=None))
    found = calibrate(narrow, array)
    assert found.method == "maximum_a_posteriori" and found.has_scalar_reference
    assert found.update.prior == "tolerances" and found.update.rates is None and not found.update.moved
    assert_allclose(found.update.prior_standard_errors[0, :9], np.sqrt(WIDE.variances())[:9])
    assert (found.update.data_share[0, :9] > 0).all() and np.isnan(found.update.data_share[0, 9:]).all()
    assert any("this is left to the tolerances of the array file" in warning for warning in found.warnings)
    assert (
        found.held_out.center_intensity_T < 1.2 * found.floor.center_intensity_T < found.before.center_intensity_T / 100
    )


def beside(tolerances, recording, sensors):
    """Return the calibration beside tolerances, none of its samples held out."""
    array = array_of(tolerances, sensors)
    return calibrate_with_weak_prior(recording, array, Known(prior_of_tolerances(recording, array)))[0]


@pytest.mark.parametrize(("tolerances", "tilt_deg", "sensors"), [(WIDE, 2, 1), (WIDE, 10, 1), (FINE, 2, 4)])
def test_standard_errors_hold_where_little_is_determined(tolerances, tilt_deg, sensors):
    """Of three runs, in each error and in each combination; none is further off than by 4.5 standard errors."""
    single, combined = [], []
    for seed in range(3):
        rng = np.random.default_rng([2, seed, tilt_deg, sensors])
        errors = drawn(tolerances, sensors, rng)
        found = pulls(beside(tolerances, turned(errors, tilt_deg, rng), sensors), errors)
        single.append(found[0])
        combined.append(found[1])
    assert rms(single) < 1.25 and rms(combined) < 1.2
    assert np.abs(combined).max() < 4.5


def test_one_narrow_turn_is_the_prior_of_the_next():
    """From tolerances by turns of 3, 10 and 20 degrees: standard errors hold all the way, and nothing has moved."""
    rng, combined = np.random.default_rng([3, 0]), []
    errors, array, known = drawn(WIDE, 1, rng), array_of(WIDE, 1), None
    for start_s, tilt_deg in ((1.7e9, 3), (1.7e9 + 1e3, 10), (1.7e9 + 2e3, 20)):
        known = calibrate(turned(errors, tilt_deg, rng, start_s), array, prior=known)
        assert not known.update.moved
        combined.append(pulls(known, errors)[1])
    assert rms(combined) < 1.2 and np.abs(combined).max() < 4.5
    assert known.standard_errors[0, 6:9].max() < 100e-9


def test_a_calibration_that_has_aged_is_not_wide():
    """Whatever its rates allow since: what moved is looked for. One that leaves errors open is, and tolerances are."""
    rng = np.random.default_rng(11)
    errors, array = drawn(WIDE, 1, rng), array_of(WIDE, 1)
    recording = turned(errors, 80, rng)
    whole = prior_of(calibrate(recording, replace(array, tolerances=None)), None, None, ChangeRates(bias_per_day=5e-6))
    assert whole.standard_errors[0, 6] > 4e-6 and not is_weak(whole)
    assert is_weak(prior_of(calibrate(turned(errors, 3, rng), array), None, None))
    assert is_weak(prior_of_tolerances(recording, array_of(FINE, 1)))


@pytest.mark.parametrize("noise_T", [NOISE_T, None])
def test_a_full_turn_needs_no_tolerances(wu_run, wu_scenario, noise_T):
    """To a hundredth of a standard error it is the plain fit; a noise that is not stated is said to be estimated."""
    array = wu_scenario.array.with_stated_noise()
    if noise_T is None:
        array = replace(array, vector_noise_T=None, scalar_noise_T=None)
    plain = calibrate(wu_run.recording, array)
    found = calibrate(wu_run.recording, replace(array, tolerances=WIDE))
    difference = (found.errors.to_vector() - plain.errors.to_vector())[1:] / plain.standard_errors[1:]
    assert np.abs(difference).max() < 0.01
    assert_allclose(found.standard_errors[1:], plain.standard_errors[1:], rtol=0.05)
    assert found.noise_is_estimated == plain.noise_is_estimated == (noise_T is None)
    assert not found.warnings and found.update.data_share[1:].min() > 0.99


def test_other_methods_do_without_tolerances(wu_run, wu_scenario):
    """They are what they are without."""
    array = wu_scenario.array
    for method in ("lossless", "robust"):
        found = calibrate(wu_run.recording, replace(array, tolerances=WIDE), method)
        assert_allclose(found.errors.to_vector(), calibrate(wu_run.recording, array, method).errors.to_vector())
        assert found.update is None


def test_biases_of_ten_times_the_field_are_found():
    """A phone's chip, its bias within tolerances of a millitesla: without errors to begin from, no way leads there."""
    rng = np.random.default_rng(12)
    errors = replace(drawn(FINE, 1, rng), bias_T=np.array([[84e-6, 207e-6, -550e-6]]))
    recording = replace(turned(errors, 80, rng), scalar_T=None)
    array = array_of(Tolerances(0.1, np.radians(3), 1e-3, np.radians(3)), 1)
    found, plain = calibrate(recording, array), calibrate(recording, replace(array, tolerances=None))
    off = found.errors.to_vector() - plain.errors.to_vector()
    assert np.abs(off[0, :9] / plain.standard_errors[0, :9]).max() < 0.01
    assert found.update.prior == "tolerances" and not found.warnings


def test_two_samples_beside_tolerances_are_little_and_no_mistake():
    """Accepted, they leave nearly all to the tolerances: their residuals have no degree of freedom."""
    rng = np.random.default_rng(15)
    errors = drawn(WIDE, 4, rng)
    found = calibrate(turned(errors, 5, rng).take([0, 200]), array_of(WIDE, 4), accept=["few_samples"])
    assert np.nanmedian(found.update.data_share) < 0.5
    assert "is left to the tolerances" in " ".join(found.warnings)


def test_the_scale_stays_a_convention_without_a_scalar():
    """As it is without tolerances: the mean determinant is one, and the rest is told with its standard errors."""
    rng = np.random.default_rng(5)
    errors = drawn(FINE, 4, rng)
    errors = replace(errors, scale_factor=free_scale(errors.matrix) * errors.scale_factor)
    found = beside(FINE, replace(turned(errors, 60, rng), scalar_T=None), 4)
    assert not found.has_scalar_reference
    assert_allclose(free_scale(found.errors.matrix), 1)
    assert rms(pulls(found, errors)[0]) < 1.5


def test_the_weight_of_the_readings_comes_from_above(monkeypatch):
    """By a tenth at a time, until what is measured is within a tenth; after 20 times it is refused.

    That of each channel falls by itself, and the other stays where it is measured.
    """
    weights = []
    monkeypatch.setattr(weak_prior, "maximum_a_posteriori", lambda *given: weights.append(given[2].variance_factors))

    def known(target, common_mode=lambda weight: weight):
        def measured(*_):
            return VarianceFactors(target(weights[-1].differential), common_mode(weights[-1].common_mode))

        monkeypatch.setattr(weak_prior, "variance_factors", measured)
        weights.clear()
        weak_prior._settled(Known(prior_of_tolerances(recording, array)), recording, array)
        return np.array([weight.differential for weight in weights])

    rng = np.random.default_rng(6)
    recording, array = turned(drawn(FINE, 1, rng), 5, rng), array_of(FINE, 1).with_stated_noise()
    falls = known(lambda _: 3e3)
    assert falls[0] > 300 * 1e3
    assert_allclose(falls[1:-1] / falls[:-2], 0.1)
    assert falls[-1] == 3e3
    assert len({weight.common_mode for weight in weights}) == 1
    assert_allclose(known(lambda _: 3e3, lambda _: 3e4), falls)
    assert weights[-1] == VarianceFactors(3e3, 3e4)
    assert len(known(lambda weight: weight / 1.1)) == 1
    with pytest.raises(Refused, match="does not settle: turn the array further, or state the noise"):
        known(lambda weight: weight / 1.12)
    assert len(weights) == 20


def test_a_noise_that_is_not_stated_is_scaled_twice_at_most(monkeypatch):
    """Beside a prior that is contradicted it would grow without end, and refuse nothing."""
    scalings = []
    scaled = weak_prior.noise_left_in
    monkeypatch.setattr(weak_prior, "noise_left_in", lambda *given: scalings.append(given) or scaled(*given))
    rng = np.random.default_rng(7)
    errors = replace(drawn(FINE, 1, rng), bias_T=np.array([[5e-6, 0, 0]]))
    with pytest.raises(Refused):
        calibrate(turned(errors, 5, rng), array_of(FINE, 1, None))
    assert len(scalings) == 2


def test_curvature_is_measured_by_a_hundred_draws_of_a_thousand_samples():
    """Of ten times as many samples that count a tenth each it is the same, for the same ones are looked at."""
    rng = np.random.default_rng(8)
    errors, array = drawn(WIDE, 1, rng), array_of(WIDE, 1)
    long = turned(errors, 10, rng, count=10_000)
    short = long.take(slice(None, None, 10))
    known = Known(prior_of_tolerances(short, array))
    calibration = maximum_a_posteriori(short, array, known)
    sizes = []
    for recording, weighed in ((short, known), (long, replace(known, variance_factors=VarianceFactors(10.0, 10.0)))):
        sizes.append(np.sum(calibration.covariance * weak_prior._curvature(calibration, recording, weighed)))
    assert (weak_prior._DRAWS, weak_prior._SAMPLES) == (100, 1000)
    assert_allclose(*sizes, rtol=1e-9)


def test_curvature_is_nothing_where_lengths_are_straight():
    """Over a data sheet's errors and 10° of tilt it is a thousandth of the noise, however far the prior pulls."""
    rng = np.random.default_rng(12)
    recording, array = turned(drawn(FINE, 1, rng), 10, rng), array_of(FINE, 1)
    known = Known(prior_of_tolerances(recording, array))
    calibration = maximum_a_posteriori(recording, array, known)
    assert known.prior.terms(calibration.errors).energy > 1
    assert np.sum(calibration.covariance * weak_prior._curvature(calibration, recording, known)) < 9e-3


def test_steps_that_overshoot_are_shortened():
    """A turn of 2° that has no end of whole steps: by shorter ones it is not taken for a contradiction."""
    rng = np.random.default_rng([7, 27, 1, 2, 300])
    assert beside(WIDE, turned(drawn(WIDE, 1, rng), 2, rng), 1).update.probability > 0.001
