"""What was learned is published only where the samples after it agree with it."""

import numpy as np
import pytest
from live_mission import ashore, dive, moved

from tam_calibration.live.recursion import Belief, MomentLikelihood
from tam_calibration.live.trial import TRIED, Trial


@pytest.fixture
def after(true_errors, cross):
    """Return a function that gives the trial of errors beside published ones, after three blocks."""
    prior = ashore(true_errors, cross, np.random.default_rng(10))
    likelihood = MomentLikelihood(prior.errors, prior.calibration.array, prior.calibration.intensity_T)

    def tried(errors, published, is_less_certain=False):
        beliefs = [Belief(each, prior.covariance, 0.0, np.nan) for each in (errors, published)]
        trial = Trial(beliefs[0], is_less_certain)
        for block in range(TRIED):
            assert not trial.is_over and not trial.has_passed
            rows = dive(true_errors, cross, np.random.default_rng(block), 2 * block + np.arange(40) / 20)
            moments = likelihood.moments(rows[:, 1:13].reshape(-1, 4, 3), rows[:, 13])
            trial = trial.after(moments, beliefs[1], likelihood)
        assert trial.is_over
        return trial

    return tried


def test_what_predicts_better_passes(after, true_errors):
    """The truth beside a bias of 10 nT, and not the other way round; also where it is less certain."""
    wrong = moved(true_errors, 2, bias_T=np.array([10e-9, 0, 0]))
    assert after(true_errors, wrong).has_passed and after(true_errors, wrong, True).has_passed
    assert not after(wrong, true_errors).has_passed


def test_what_is_less_certain_has_to_be_much_better(after, true_errors):
    """Three tenths of a nanotesla are no reason to give up a calibration that is more certain."""
    near = moved(true_errors, 2, bias_T=np.array([0.3e-9, 0, 0]))
    assert not after(true_errors, near, True).has_passed
