import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.blind import amplifier


def states(scene, cause, sensor):
    """Return change over reading (N, 3): by what part of itself each reading is changed."""
    vectors, _ = cause.change(1.0, ())
    return vectors[:, sensor] / scene.readings_T[:, sensor]


def first_axis(change):
    """Return the first axis that is changed at all."""
    return int(np.flatnonzero(np.abs(change).max(axis=0))[0])


@pytest.mark.parametrize("seed", range(6))
def test_a_switched_gain_has_two_states(draw, seed):
    """The reading with its bias is multiplied by one of two factors, and changes between them many times."""
    scene = draw(seed, samples=1500)
    cause = amplifier.gain_switching(np.random.default_rng(seed), scene)
    part = states(scene, cause, cause.sensors[0] - 1)
    gain = part[:, first_axis(part)]
    high = gain > gain.max() / 2
    assert_allclose(gain[high], gain.max(), rtol=1e-9)
    assert_allclose(gain[~high], 0, atol=1e-20)
    assert np.count_nonzero(np.diff(high)) >= amplifier.LEAST_FLIPS - 1


@pytest.mark.parametrize("seed", range(6))
def test_a_scale_factor_steps_once_or_twice(draw, seed):
    """The reading with its bias is multiplied by a constant before the step and by another one after it."""
    scene = draw(seed)
    cause = amplifier.scale_step(np.random.default_rng(seed), scene)
    part = states(scene, cause, cause.sensors[0] - 1)
    gain = part[:, first_axis(part)]
    steps = np.flatnonzero(np.abs(np.diff(gain)) > 1e-6 * np.abs(gain).max())
    assert len(steps) == len(cause.parameters["times_s"]) in (1, 2)
    assert_allclose(gain[: steps[0] + 1], 0, atol=1e-20)


def test_what_leaks_is_a_reading_of_another_sensor(draw):
    """A late leak is the source's waveform at an earlier time."""
    for seed in range(40):
        scene = draw(seed)
        cause = amplifier.crosstalk(np.random.default_rng(seed), scene)
        if not cause.parameters["hurried"]:
            break
    vectors, _ = cause.change(1.0, ())
    leaked = vectors[:, cause.sensors[0] - 1]
    leaked = leaked[:, first_axis(leaked)]
    source = scene.readings_at(scene.time_s - cause.parameters["late_s"])[:, cause.parameters["from"] - 1]
    fitted = np.linalg.lstsq(source, leaked, rcond=None)
    assert cause.parameters["from"] != cause.sensors[0]
    assert fitted[1][0] < 1e-20 * (leaked**2).sum() and np.count_nonzero(np.abs(fitted[0]) > 1e-12) == 1


def test_a_filter_rings_at_its_frequency_and_dies(draw):
    """After one step of the field the answer is the damped oscillation of the key, and in the end nothing."""
    scene = draw(3)
    step = np.zeros((scene.sample_count, 3))
    step[10:] = 1.0
    scene.__dict__["readings_T"] = np.repeat(step[:, None], 4, axis=1) * scene.intensity_T.mean()
    scene.bias_T[:] = 0
    cause = amplifier.ringing(np.random.default_rng(3), scene)
    vectors, _ = cause.change(1.0, ())
    rung = vectors[:, cause.sensors[0] - 1]
    rung = rung[:, first_axis(rung)]
    assert_allclose(rung[:10], 0)
    n = np.arange(200)
    decay = np.exp(-n * scene.step_s / cause.parameters["decay_s"])
    turn = 2 * np.pi * cause.parameters["frequency_hz"] * scene.step_s * n
    basis = np.column_stack([decay * np.cos(turn), decay * np.sin(turn)])
    fitted = np.linalg.lstsq(basis, rung[10:210], rcond=None)
    assert_allclose(basis @ fitted[0], rung[10:210], atol=1e-9 * np.abs(rung).max())
    assert abs(rung[-1]) < 1e-6 * np.abs(rung).max()
