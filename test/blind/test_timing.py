import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from tam_calibration.blind import timing


def seen(scene):
    """Return the readings with noise, and the scalar."""
    noise = np.random.default_rng(0).normal(size=scene.readings_T.shape) * scene.vector_noise_T
    return scene.readings_T + noise, scene.intensity_T


@pytest.mark.parametrize("seed", range(8))
def test_a_stale_sample_is_an_earlier_reading_noise_and_all(draw, seed):
    """Every changed sample is exactly one of the readings before it; about the share asked for is changed."""
    scene = draw(seed, samples=2000)
    cause = timing.stale_samples(np.random.default_rng(seed), scene)
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
    cause = timing.timing_jitter(np.random.default_rng(4), scene)
    sensor = cause.sensors[0] - 1
    change, _ = cause.change(1e-4, ())
    rate = np.gradient(scene.readings_T[:, sensor], scene.time_s, axis=0)
    early = (change[:, sensor] * rate).sum(axis=1) / (rate**2).sum(axis=1)
    assert_allclose(early.std(), 1e-4, rtol=0.1)


def test_what_was_lost_lies_on_lines(draw):
    """Within a filled stretch the readings have no second difference; elsewhere they are as they were."""
    scene = draw(5, samples=1500)
    cause = timing.interpolated_samples(np.random.default_rng(5), scene)
    readings, scalar = seen(scene)
    change, _ = cause.change(8.0, (readings, scalar))
    sensor = cause.sensors[0] - 1
    lost = np.abs(change[:, sensor]).max(axis=1) > 0
    recorded = (readings + change)[:, sensor]
    inside = lost[:-2] & lost[1:-1] & lost[2:]
    assert inside.sum() > 20
    assert_allclose(np.diff(recorded, 2, axis=0)[inside], 0, atol=1e-18)
    assert_array_equal(np.delete(change, sensor, axis=1), 0)
