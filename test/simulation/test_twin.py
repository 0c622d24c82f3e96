"""The twin of a calibrated array has its errors, effects and noise on the run of a recording, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.correction.parts import EffectSize
from tam_calibration.fit import calibrate
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.simulation.observe import twin

DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 0.0, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 5e-9}),),
)
UNKNOWN_SIZE = EffectSize(np.zeros(9), np.zeros(9))


@pytest.fixture(scope="module")
def run_with_hole(recording):
    """Return a recording with a temperature, and a scalar that is silent for a while."""
    scalar = recording.scalar_T.copy()
    scalar[100:200] = np.nan
    return replace(recording, scalar_T=scalar, temperature_C=np.linspace(15, 25, recording.sample_count))


@pytest.fixture(scope="module")
def calibration(run_with_hole, cross):
    """Return a calibration that keeps a drift which the recording does not hold."""
    return replace(calibrate(run_with_hole, cross), effects=(DRIFT,), effect_sizes=(UNKNOWN_SIZE,))


def test_the_twin_differs_from_its_run_by_noise_and_effect(calibration, run_with_hole):
    """Channels and times are those of the run, the scalar is silent where it was, the readings are the model's."""
    made = twin(calibration, with_drift(run_with_hole), 3)
    assert_array_equal(made.time_s, run_with_hole.time_s)
    assert_array_equal(made.temperature_C, run_with_hole.temperature_C)
    assert_array_equal(np.isnan(made.scalar_T), np.isnan(run_with_hole.scalar_T))
    difference = made.readings_T - run_with_hole.readings_T
    drift = 5e-9 * (run_with_hole.temperature_C - 20)
    difference[:, 1, 0] -= drift
    # The run's own noise is in the readings, and a quarter of its variance in the field of the twin.
    assert_allclose(difference.std(axis=0), 1e-9 * np.sqrt(1 + 1 - 1 / 4), rtol=0.2)


def test_the_same_seed_makes_the_same_twin(calibration, run_with_hole):
    """Noise depends on the seed, and on nothing else."""
    first, again, other = (twin(calibration, run_with_hole, seed) for seed in (1, 1, 2))
    assert_array_equal(first.readings_T, again.readings_T)
    assert (first.readings_T != other.readings_T).all()


@pytest.mark.parametrize(("left", "expected"), [(0.81, 0.9), (1.21, 1.1), (25.0, 1.2)])
def test_the_noise_is_that_which_the_calibration_found(calibration, run_with_hole, left, expected):
    """Noise up to 1.2 times that stated is noise; what is more is a gap that the twin does not show."""
    plain = replace(calibration, effects=(), effect_sizes=())
    quiet = replace(plain, reduced_chi_square={"differential": 1e-12, "common_mode": 1e-12})
    noisy = replace(plain, reduced_chi_square={"differential": left, "common_mode": left})
    noise = twin(noisy, run_with_hole, 1).readings_T - twin(quiet, run_with_hole, 1).readings_T
    assert noise.std() == pytest.approx(expected * 1e-9, rel=0.05)


def test_an_axis_that_rounds_does_not_tell_the_field_of_its_twin(calibration, run_with_hole):
    """Readings in coarse steps are made again from the field of the other sensors, and rounded anew."""
    step = 100e-9
    coarse = FittedEffect("quantization", {}, (Contribution(1, 1, "lattice", {"step": step, "offset": 0.0}),))
    keeping = replace(calibration, effects=(coarse,), effect_sizes=(UNKNOWN_SIZE,))
    readings = run_with_hole.readings_T.copy()
    readings[:, 1, 1] = np.round(readings[:, 1, 1] / step) * step
    made = twin(keeping, replace(run_with_hole, readings_T=readings), 1).readings_T[:, 1, 1]
    assert_allclose(np.round(made / step), made / step, atol=1e-6)
    assert np.sqrt(np.mean((made - run_with_hole.readings_T[:, 1, 1]) ** 2)) == pytest.approx(step / 12**0.5, rel=0.1)


def test_a_twin_needs_the_channels_of_its_effects(calibration, recording):
    """Without temperature there is no drift to show."""
    with pytest.raises(InputError, match="needs the temperature"):
        twin(calibration, recording, 1)


def with_drift(run):
    """Return the run as an array with the calibration's effect would have recorded it."""
    readings = run.readings_T.copy()
    readings[:, 1, 0] += 5e-9 * (run.temperature_C - 20)
    return replace(run, readings_T=readings)
