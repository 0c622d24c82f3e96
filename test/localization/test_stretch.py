"""Whether an alternating source has the frequency that is stated, and one phase."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tam_calibration.localization.alternating import estimator_of, frequency_of, require_one_phase
from tam_calibration.model.exceptions import Refused
from tam_calibration.sources.demodulation import Stretch, background_of, demodulate, turning_of

TIME_S = np.arange(800) / 100
SIZES = np.array([3.0, -1.0, 0.5, 2.0])


def stretch(hertz=10.0, phases=0.0, noise=0.01, seed=1, part=slice(None)):
    """Return four channels of a source with noise."""
    time = TIME_S[part]
    signal = SIZES * np.sin(2 * np.pi * hertz * time[:, None] + 0.3 + phases)
    noise = noise * np.random.default_rng(seed).normal(size=signal.shape)
    return Stretch(time, signal + noise, background_of(time))


def test_a_stated_frequency_that_is_true_stays():
    """In all but one of a thousand recordings."""
    assert sum(frequency_of([stretch(seed=seed)], 10.0, True) == 10.0 for seed in range(30)) >= 29


def test_a_stated_frequency_that_is_off_is_refused_with_the_true_one():
    """By a fiftieth of a hertz the phase advances by 57° in eight seconds."""
    with pytest.raises(Refused, match=r"the phase advances by 57\.\d° in 7\.99 s\. State 10\.02 Hz"):
        frequency_of([stretch(10.02)], 10.0, True)
    assert frequency_of([stretch(10.02)], 10.0, False) == pytest.approx(10.02, abs=1e-4)


def test_a_stated_frequency_that_was_rounded_is_found():
    """A thousandth of a hertz matters and is no mistake."""
    assert frequency_of([stretch(10.001)], 10.0, True) == pytest.approx(10.001, abs=1e-4)


def test_poses_need_not_keep_their_phase():
    """A source that is switched between two stretches has one frequency."""
    parts = [stretch(part=slice(400)), stretch(phases=1.0, part=slice(400, 800))]
    assert frequency_of(parts, 10.0, True) == 10.0


def test_noise_has_no_frequency():
    """The stated one stays."""
    quiet = stretch(noise=0.0)
    noise = np.random.default_rng(3).normal(size=quiet.channels.shape)
    assert frequency_of([Stretch(TIME_S, noise, quiet.background)], 10.0, True) == 10.0


def test_one_phase_is_one_source():
    """All channels together, in several stretches of other phases."""
    require_one_phase([demodulate(stretch(phases=phase), 10.0) for phase in (0.0, 1.0)])


def test_two_phases_are_two_sources():
    """A channel that is 0.1 rad behind the others is refused; 0.1 mrad of the clocks is not, whatever the noise."""
    with pytest.raises(Refused, match="there are two sources, or the sensors' clocks differ"):
        require_one_phase([demodulate(stretch(phases=np.array([0, 0, 0, 0.1])), 10.0)])
    require_one_phase([demodulate(stretch(phases=np.array([0, 0, 0, 1e-4]), noise=1e-7), 10.0)])


def test_the_estimator_makes_the_amplitudes_that_turn():
    """Field and gradient that rest in the world, as demodulation finds them, with the covariance of their noise."""
    turns = Rotation.from_euler("zyx", 0.4 * np.sin(np.outer(TIME_S, [1.1, 1.7, 2.3])))
    turning, background = turning_of(turns.as_quat()), background_of(TIME_S, turns.as_quat())
    truth = np.array([1.0, -2, 3, 0.5, 1, -1, 2, 0.3])
    swing = np.sin(2 * np.pi * 10 * TIME_S)[:, None]
    found = []
    for seed in range(30):
        noise = 0.1 * np.random.default_rng(seed).normal(size=(800, 8))
        own = Stretch(TIME_S, swing * (turning @ truth) + noise, background, turning)
        _, estimator, covariance = estimator_of(own, demodulate(own, 10.0))
        found.append(np.einsum("onp,np->o", estimator, own.channels))
    pulls = (np.array(found) - truth) / np.sqrt(np.diag(covariance))
    assert np.sqrt(np.mean(pulls**2)) == pytest.approx(1, abs=0.15)
