"""Effects in a simulated recording."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.array import Array
from tam_calibration.effects.fitted import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.exceptions import InputError
from tam_calibration.files.scenario import read_scenario
from tam_calibration.sensor_errors import SensorErrors
from tam_calibration.simulation import Scenario, simulate
from tam_calibration.simulation.attitude import Tumble
from tam_calibration.simulation.channels import Current, ScalarReference, Temperature
from tam_calibration.simulation.sources import field_from_elements

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
