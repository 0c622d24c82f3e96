import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_validation.blind import instrument_faults


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
    cause = instrument_faults.gain_switching(np.random.default_rng(seed), scene)
    part = states(scene, cause, cause.sensors[0] - 1)
    gain = part[:, first_axis(part)]
    high = gain > gain.max() / 2
    assert_allclose(gain[high], gain.max(), rtol=1e-9)
    assert_allclose(gain[~high], 0, atol=1e-20)
    assert np.count_nonzero(np.diff(high)) >= instrument_faults.LEAST_FLIPS - 1


@pytest.mark.parametrize("seed", range(6))
def test_a_scale_factor_steps_once_or_twice(draw, seed):
    """The reading with its bias is multiplied by a constant before the step and by another one after it."""
    scene = draw(seed)
    cause = instrument_faults.scale_step(np.random.default_rng(seed), scene)
    part = states(scene, cause, cause.sensors[0] - 1)
    gain = part[:, first_axis(part)]
    steps = np.flatnonzero(np.abs(np.diff(gain)) > 1e-6 * np.abs(gain).max())
    assert len(steps) == len(cause.parameters["times_s"]) in (1, 2)
    assert_allclose(gain[: steps[0] + 1], 0, atol=1e-20)


def test_what_leaks_is_a_reading_of_another_sensor(draw):
    """A late leak is the source's waveform at an earlier time."""
    for seed in range(40):
        scene = draw(seed)
        cause = instrument_faults.crosstalk(np.random.default_rng(seed), scene)
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
    cause = instrument_faults.ringing(np.random.default_rng(3), scene)
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


def seen(scene):
    """Return the readings with noise, and the scalar."""
    noise = np.random.default_rng(0).normal(size=scene.readings_T.shape) * scene.vector_noise_T
    return scene.readings_T + noise, scene.intensity_T


@pytest.mark.parametrize("seed", range(8))
def test_a_stale_sample_is_an_earlier_reading_noise_and_all(draw, seed):
    """Every changed sample is exactly one of the readings before it; about the share asked for is changed."""
    scene = draw(seed, samples=2000)
    cause = instrument_faults.stale_samples(np.random.default_rng(seed), scene)
    readings, scalar = seen(scene)
    change, _ = cause.change(0.1, (readings, scalar))
    sensor = cause.sensors[0] - 1
    changed = np.flatnonzero(np.abs(change[:, sensor]).max(axis=1) > 0)
    recorded = (readings + change)[:, sensor]
    back = cause.parameters["behind_by"]
    for sample in changed:
        earlier = readings[sample - back, sensor] if back else readings[max(0, sample - 60) : sample, sensor]
        assert np.isclose(earlier, recorded[sample], rtol=0, atol=1e-16).reshape(-1, 3).all(axis=1).any()
    assert 0.04 < len(changed) / 2000 < 0.2


def test_jitter_is_the_waveform_at_other_times(draw):
    """The change is the rate of the reading by the time that the sample was early or late, of the size asked for."""
    scene = draw(4, samples=3000)
    cause = instrument_faults.timing_jitter(np.random.default_rng(4), scene)
    sensor = cause.sensors[0] - 1
    change, _ = cause.change(1e-4, ())
    rate = np.gradient(scene.readings_T[:, sensor], scene.time_s, axis=0)
    early = (change[:, sensor] * rate).sum(axis=1) / (rate**2).sum(axis=1)
    assert_allclose(early.std(), 1e-4, rtol=0.1)


def test_what_was_lost_lies_on_lines(draw):
    """Within a filled stretch the readings have no second difference; elsewhere they are as they were."""
    scene = draw(5, samples=1500)
    cause = instrument_faults.interpolated_samples(np.random.default_rng(5), scene)
    readings, scalar = seen(scene)
    change, _ = cause.change(8.0, (readings, scalar))
    sensor = cause.sensors[0] - 1
    lost = np.abs(change[:, sensor]).max(axis=1) > 0
    recorded = (readings + change)[:, sensor]
    inside = lost[:-2] & lost[1:-1] & lost[2:]
    assert inside.sum() > 20
    assert_allclose(np.diff(recorded, 2, axis=0)[inside], 0, atol=1e-18)
    assert_array_equal(np.delete(change, sensor, axis=1), 0)
