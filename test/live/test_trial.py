"""What was learned is published only where the samples after it agree with it."""

import numpy as np
import pytest
from live_mission import ashore, dive, moved

from tam_calibration.live.recursion import Belief, MomentLikelihood
from tam_calibration.live.trial import MOST_TRIED, TRIED, Trial


@pytest.fixture
def after(true_errors, cross):
    """Return a function that gives the trial of errors beside published ones, once it is over."""
    prior = ashore(true_errors, cross, np.random.default_rng(10))
    likelihood = MomentLikelihood(prior.errors, prior.calibration.array, prior.calibration.intensity_T)

    def tried(errors, published, is_less_certain=False):
        beliefs = [Belief(each, prior.covariance, 0.0, np.nan) for each in (errors, published)]
        trial = Trial(beliefs[0], is_less_certain)
        for block in range(MOST_TRIED):
            if trial.is_over:
                break
            assert not trial.has_passed
            rows = dive(true_errors, cross, np.random.default_rng(block), 2 * block + np.arange(40) / 20)
            moments = likelihood.moments(rows[:, 1:13].reshape(-1, 4, 3), rows[:, 13])
            trial = trial.after(moments, beliefs[1], likelihood)
        assert trial.is_over and trial.blocks >= TRIED
        return trial

    return tried


def test_what_predicts_better_passes(after, true_errors):
    """The truth beside a bias of 10 nT, and not the other way round; also where it is less certain."""
    wrong = moved(true_errors, 2, bias_T=np.array([10e-9, 0, 0]))
    for is_less_certain in (False, True):
        trial = after(true_errors, wrong, is_less_certain)
        assert trial.has_passed and trial.blocks == TRIED
    assert not after(wrong, true_errors).has_passed


def test_where_blocks_are_not_clear_more_of_them_are_tried(after, true_errors):
    """A hundredth of a nanotesla is nothing in six seconds of 20 Hz."""
    near = moved(true_errors, 2, bias_T=np.array([0.01e-9, 0, 0]))
    assert after(true_errors, near).blocks == MOST_TRIED


def test_what_is_less_certain_has_to_be_much_better(after, true_errors):
    """Three tenths of a nanotesla are no reason to give up a calibration that is more certain."""
    near = moved(true_errors, 2, bias_T=np.array([0.3e-9, 0, 0]))
    assert not after(true_errors, near, True).has_passed
