"""Effects in a simulated recording."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.linalg import norm
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.results.scenario import read_scenario
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.conditions import (
    AttitudeChannel,
    Current,
    RandomAttitudes,
    ScalarReference,
    SinusoidDrift,
    Temperature,
    Tumble,
    field_from_elements,
)
from tam_calibration.sources.dipole import Dipole

DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 0.0, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 2e-9}),),
)
NOISE = FittedEffect("noise_excess", {}, (Contribution(2, None, "noise", {"standard deviation": 3e-9}),))
STEPS = FittedEffect("quantization", {}, (Contribution(ALL, None, "lattice", {"step": 5e-9}),))
LIMIT = FittedEffect("saturation", {}, (Contribution(0, 2, "limit", {"upper limit": 30.0021e-6}),))
SPIKES = FittedEffect(
    "outliers", {}, (Contribution(SCALAR, None, "spikes", {"rate": 0.05, "size": 100e-9, "burst": 1.0}),)
)


def scenario(*effects, **changes):
    """Return a tumble of four sensors with noise and every channel."""
    plain = Scenario(
        Array.cross(0.5, 1e-9, 0.1e-9),
        SensorErrors.none(4),
        field_from_elements(50e-6, 1.0, 0.1),
        Tumble(),
        sample_count=400,
        rate_hz=10.0,
        seed=3,
        scalar=ScalarReference(rate_hz=5.0),
        temperature=Temperature(15.0, 25.0, 0.1),
        current=Current(0.0, 2.0, 5.0, 0.1),
    )
    return replace(plain, effects=effects, **changes)


def added(*effects):
    """Return what effects change in readings (N, K, 3) and scalar (N,)."""
    plain, full = simulate(scenario()).recording, simulate(scenario(*effects)).recording
    return full.readings_T - plain.readings_T, full.scalar_T - plain.scalar_T


def test_an_effect_follows_the_true_channel():
    """The bias drifts with the temperature itself, not with its noisy reading, in the stated axis alone."""
    readings, scalar = added(DRIFT)
    temperature = Temperature(15.0, 25.0).course(np.arange(400) / 10)
    assert_allclose(readings[:, 1, 0], 2e-9 * (temperature - 20), atol=1e-19)
    readings[:, 1, 0] = 0
    assert_array_equal(readings, 0)
    assert_array_equal(scalar[::2], 0)


def test_the_last_word_is_the_converter_s():
    """Whatever the order of the listing, readings are cut off at the limit and then rounded."""
    first = simulate(scenario(STEPS, LIMIT, NOISE, DRIFT)).recording.readings_T
    second = simulate(scenario(STEPS, LIMIT, NOISE)).recording.readings_T
    for readings in (first, second):
        assert_allclose(readings, np.round(readings / 5e-9) * 5e-9, atol=1e-18)
        assert_allclose(readings[:, 0, 2].max(), 30e-6, atol=1e-18)
        assert np.sum(readings[:, 0, 2] > 29.9999e-6) > 20


def test_random_effects_leave_the_other_noise():
    """Each effect has a generator of its own: what one more draws changes no other number."""
    noise, _ = added(NOISE)
    assert_allclose(noise[:, 2].std(), 3e-9, rtol=0.1)
    with_spikes, scalar = added(NOISE, SPIKES)
    assert_array_equal(noise, with_spikes)
    assert 5 < np.sum(np.abs(np.nan_to_num(scalar)) > 10e-9) < 30
    assert_array_equal(added(NOISE)[0], noise)


def test_missing_readings_of_the_scalar_stay_missing():
    """An effect on the scalar magnetometer adds no reading where there was none."""
    for effect in (SPIKES, FittedEffect("quantization", {}, (Contribution(SCALAR, None, "lattice", {"step": 1e-9}),))):
        recording = simulate(scenario(effect)).recording
        assert_array_equal(np.isfinite(recording.scalar_T), np.arange(400) % 2 == 0)


def test_a_shipped_scenario_has_an_effect():
    """While it warms up, sensor 2 of warming_up drifts by some nT, and no other."""
    plan = read_scenario("warming_up")
    drift = simulate(plan).recording.readings_T - simulate(replace(plan, effects=())).recording.readings_T
    assert 4e-9 < np.abs(drift[:, 1, 0]).max() < 20e-9
    assert_array_equal(drift[:, [0, 2, 3]], 0)


@pytest.mark.parametrize(
    ("effect", "changes", "sentence"),
    [
        (FittedEffect("magic", {}, ()), {}, "no effect 'magic': choose one of ambient_gradient"),
        (DRIFT, {"temperature": None}, "temperature_drift follows the temperature: add temperature to the scenario"),
        (replace(DRIFT, shape={}), {}, "temperature_drift needs the value 'time_constant_s'"),
        (
            replace(NOISE, contributions=(Contribution(7, None, "noise", {"standard deviation": 1e-9}),)),
            {},
            "acts on sensor 8, and there are 4",
        ),
        (
            replace(NOISE, contributions=(Contribution(1, None, "noise", {}),)),
            {},
            "needs the value 'standard deviation'",
        ),
        (
            replace(DRIFT, contributions=(Contribution(1, 0, "ofset", {"offset": 1e-9}),)),
            {},
            "'ofset' is none of the terms of temperature_drift: they are offset, quadratic offset, scale",
        ),
        (
            replace(DRIFT, contributions=(Contribution(1, None, "offset", {"offset": 1e-9}),)),
            {},
            "there are none of that sensor and axis",
        ),
        (
            replace(DRIFT, contributions=(Contribution(1, 0, "offset", {"ofset": 1e-9}),)),
            {},
            "'ofset' is no value of the term 'offset' of temperature_drift: it has offset",
        ),
    ],
)
def test_an_effect_that_cannot_be_is_refused(effect, changes, sentence):
    """What is not known or missing is named."""
    with pytest.raises(InputError, match=sentence):
        simulate(scenario(effect, **changes))


INTENSITY_T = 54955.83e-9
SITE = field_from_elements(INTENSITY_T, np.radians(62.3), np.radians(-9.9))


def wrong_sensors(count=4):
    """Return errors of a few per cent, some tenths of a degree and some tens of nT."""
    rng = np.random.default_rng(7)
    angle = np.radians(rng.uniform(-0.5, 0.5, (2, count, 3)))
    return SensorErrors(
        1 + rng.uniform(-0.05, 0.05, (count, 3)), angle[0], rng.uniform(-40e-9, 40e-9, (count, 3)), angle[1]
    )


def scenario_of_observe(**changes):
    """Return a noise-free scenario of the cross with random attitudes."""
    plain = Scenario(Array.cross(0.5), wrong_sensors(), SITE, RandomAttitudes(), sample_count=200, rate_hz=10.0, seed=1)
    return replace(plain, **{"scalar": ScalarReference(), **changes})


def test_uniform_field_is_restored_exactly():
    """Without noise the true errors turn the readings back into the true field of the centre."""
    made = simulate(scenario_of_observe())
    restored = made.errors.restore(made.recording.readings_T)
    assert_allclose(restored, np.repeat(made.center_field_T[:, None], 4, axis=1), atol=1e-18)


def test_intensity_of_a_uniform_field_is_constant_in_every_attitude():
    """Turning the array does not change the intensity, which is what the scalar magnetometer reads."""
    made = simulate(scenario_of_observe())
    assert_allclose(norm(made.center_field_T, axis=1), INTENSITY_T, rtol=1e-13)
    assert_allclose(made.recording.scalar_T, INTENSITY_T, rtol=1e-13)
    assert_array_equal(made.gradient_T_per_m, 0)


def test_attitude_turns_the_centre_field_into_the_world():
    """The true attitude carries the field of the array frame back to the site's."""
    made = simulate(scenario_of_observe(attitude=AttitudeChannel()))
    assert_allclose(Rotation.from_quat(made.attitude).apply(made.center_field_T), np.tile(SITE, (200, 1)), atol=1e-18)
    turned = Rotation.from_quat(made.recording.attitude).inv() * Rotation.from_quat(made.attitude)
    assert_allclose(turned.magnitude(), 0, atol=1e-7)


def test_a_site_gradient_reaches_sensors_scalar_and_truth():
    """Perfect sensors read the uniform field and G times their place in the world; so does the scalar magnetometer."""
    gradient = 1e-9 * np.array([[120, -80, 60], [-80, -200, 90], [60, 90, 80]])
    array = replace(Array.cross(0.5), scalar_position_m=np.array([0.3, -0.2, 0.9]))
    made = simulate(scenario_of_observe(array=array, errors=SensorErrors.none(4), site_gradient_T_per_m=gradient))
    rotation = Rotation.from_quat(made.attitude)
    for sensor, position in enumerate(array.positions_m):
        world = rotation.apply(made.recording.readings_T[:, sensor])
        assert_allclose(world, SITE + rotation.apply(position) @ gradient, atol=1e-18)
    at_scalar = SITE + rotation.apply(array.scalar_position_m) @ gradient
    assert_allclose(made.recording.scalar_T, norm(at_scalar, axis=1), rtol=1e-13)
    outputs = made.recording.readings_T.reshape(200, -1) @ array.operator.T
    assert_allclose(outputs[:, 3:], made.gradient_T_per_m[:, *np.triu_indices(3)], atol=1e-18)


def test_a_gradient_must_be_one_of_a_field_without_sources():
    """A tensor with a trace, or that is not symmetric, is refused."""
    for wrong in (np.diag([1e-7, 0, 0]), 1e-7 * np.eye(3)[[1, 2, 0]]):
        with pytest.raises(InputError, match="must be symmetric, and its diagonal add up to zero"):
            scenario_of_observe(site_gradient_T_per_m=wrong)


def test_scalar_follows_the_drift():
    """The intensity read by the scalar magnetometer has the drift's standard deviation."""
    made = simulate(scenario_of_observe(drift=SinusoidDrift(8.26e-9, 7.0)))
    assert_allclose(made.recording.scalar_T.std(), 8.26e-9, rtol=1e-6)


def test_dipole_gives_each_sensor_its_own_field():
    """Far away the array's operator finds the true centre field and gradient of a dipole from perfect sensors."""
    array = Array.cross(0.5)
    dipole = Dipole(np.array([8.0, -5.0, 3.0]), np.array([100.0, 2000.0, -3000.0]))
    made = simulate(scenario_of_observe(array=array, errors=SensorErrors.none(4), dipole=dipole))
    outputs = made.recording.readings_T.reshape(200, -1) @ array.operator.T
    true = made.gradient_T_per_m
    expected = np.stack([true[:, i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))], axis=1)
    size = norm(expected, axis=1).mean()
    assert size > 1e-9
    assert_allclose(outputs[:, 3:], expected, atol=0.02 * size)
    # The least-squares centre takes up the second derivatives of the field: baseline²/(16 r⁴) of the dipole's.
    assert_allclose(outputs[:, :3], made.center_field_T, atol=0.25**2 * size)


def test_gradient_of_the_dipole_obeys_maxwell_in_the_array_frame():
    """The true tensor is symmetric and trace-free in every attitude, and its size does not depend on it."""
    dipole = Dipole(np.array([2.4, -1.0, 0.46]), np.array([0.0, 300.0, 400.0]))
    gradient = simulate(scenario_of_observe(dipole=dipole)).gradient_T_per_m
    assert_allclose(gradient, np.swapaxes(gradient, 1, 2), atol=1e-20)
    assert_allclose(np.trace(gradient, axis1=1, axis2=2), 0, atol=1e-20)
    assert_allclose(norm(gradient, axis=(1, 2)), norm(gradient[0]), rtol=1e-12)


def test_noise_has_the_stated_size_and_is_independent():
    """Every axis of every sensor has white noise of its own sensor's size."""
    sizes = np.array([1e-9, 2e-9, 3e-9, 4e-9])
    noisy = scenario_of_observe(array=Array(Array.cross(0.5).positions_m, sizes, 0.1e-9), sample_count=5000)
    made = simulate(noisy)
    noise = made.recording.readings_T - made.errors.distort(made.center_field_T)
    assert_allclose(noise.std(axis=0), np.repeat(sizes[:, None], 3, axis=1), rtol=0.05)
    correlation = np.corrcoef(noise.reshape(5000, -1).T) - np.eye(12)
    assert np.abs(correlation).max() < 0.06
    assert_allclose((made.recording.scalar_T - INTENSITY_T).std(), 0.1e-9, rtol=0.05)


def test_scalar_error_can_be_one_draw_for_the_recording():
    """As Wu 2025 Fig. 6 needs it, the scalar magnetometer is off by the same amount in every sample."""
    array = Array.cross(0.5, 1e-9, 5e-9)
    made = simulate(scenario_of_observe(array=array, scalar=ScalarReference(one_error_per_recording=True)))
    error = made.recording.scalar_T - INTENSITY_T
    assert np.ptp(error) < 1e-18
    assert 0 < abs(error[0]) < 25e-9


def test_scalar_may_read_more_slowly_than_the_sensors():
    """At 2 Hz beside 10 Hz every fifth sample has a scalar reading, the first one too."""
    made = simulate(scenario_of_observe(scalar=ScalarReference(rate_hz=2.0)))
    assert_array_equal(np.flatnonzero(np.isfinite(made.recording.scalar_T)), np.arange(0, 200, 5))


def test_channels_are_absent_unless_asked_for():
    """A scenario without them has no scalar, temperature, current or attitude."""
    made = simulate(scenario_of_observe(scalar=None)).recording
    assert made.scalar_T is made.temperature_C is made.current_A is made.attitude is None


def test_channels_have_the_stated_course():
    """Temperature runs from start to end, current switches between its levels, attitude errs by its noise."""
    made = simulate(
        scenario_of_observe(
            temperature=Temperature(14.0, 9.0),
            current=Current(0.5, 6.0, 4.0),
            attitude=AttitudeChannel(np.radians(0.1)),
            sample_count=2000,
        )
    )
    recording = made.recording
    assert_allclose(recording.temperature_C[[0, -1]], [14, 9])
    assert set(recording.current_A) == {0.5, 6.0}
    assert_array_equal(recording.current_A[:40], np.repeat([0.5, 6.0], 20))
    error = Rotation.from_quat(made.attitude).inv() * Rotation.from_quat(recording.attitude)
    assert_allclose(error.as_rotvec(degrees=True).std(axis=0), 0.1, rtol=0.06)


def test_a_seed_repeats_the_recording():
    """The same seed gives the same bytes, another seed other noise and attitudes."""
    noisy = scenario_of_observe(array=Array.cross(0.5, 1e-9, 0.1e-9))
    first, again, other = (simulate(replace(noisy, seed=seed)).recording for seed in (5, 5, 6))
    assert_array_equal(first.readings_T, again.readings_T)
    assert_array_equal(first.scalar_T, again.scalar_T)
    assert not np.allclose(first.readings_T, other.readings_T)


def test_a_further_channel_leaves_the_noise_of_the_others():
    """Temperature, current and attitude have generators of their own."""
    noisy = scenario_of_observe(array=Array.cross(0.5, 1e-9, 0.1e-9), motion=Tumble())
    more = replace(
        noisy, temperature=Temperature(1, 2, 0.1), current=Current(0, 1, 3, 0.1), attitude=AttitudeChannel(0.01)
    )
    plain, full = simulate(noisy).recording, simulate(more).recording
    assert_array_equal(plain.readings_T, full.readings_T)
    assert_array_equal(plain.scalar_T, full.scalar_T)


def test_a_further_sensor_leaves_the_noise_of_the_others():
    """Each sensor has a generator of its own."""
    positions = Array.cross(0.5).positions_m
    few, many = (
        simulate(
            scenario_of_observe(array=Array(positions[:count], np.full(count, 1e-9)), errors=SensorErrors.none(count))
        )
        for count in (2, 4)
    )
    assert_array_equal(few.recording.readings_T, many.recording.readings_T[:, :2])


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"errors": SensorErrors.none(3)}, "errors of 3 sensors and an array of 4"),
        ({"sample_count": 0}, "at least one sample, not 0"),
        ({"rate_hz": 0.0}, "positive number of samples per second, not 0"),
        ({"rate_hz": float("nan")}, "positive number of samples per second, not nan"),
    ],
)
def test_a_scenario_that_cannot_be_is_refused(changes, sentence):
    """Counts and rates out of range are named."""
    with pytest.raises(InputError, match=sentence):
        scenario_of_observe(**changes)
