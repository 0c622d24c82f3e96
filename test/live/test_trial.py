"""What was learned is published only where the samples after it agree with it."""

from dataclasses import replace

import numpy as np
import pytest
from live_mission import ashore, dive, moved

from tam_calibration.live.recursion import CLEARLY_BETTER, MOST_TRIED, TRIED, Belief, MomentLikelihood, Trial


@pytest.fixture
def after(true_errors, cross):
    """Return a function that gives the trial of errors beside published ones, once it is over."""
    prior = ashore(true_errors, cross, np.random.default_rng(10))
    likelihood = MomentLikelihood(prior.errors, prior.calibration.array, prior.calibration.intensity_T)

    def tried(errors, published, scalar_T=0.0):
        beliefs = [Belief(each, prior.covariance, 0.0, np.nan) for each in (errors, published)]
        trial = Trial(beliefs[0])
        for block in range(MOST_TRIED):
            if trial.is_over:
                break
            rows = dive(true_errors, cross, np.random.default_rng(block), 2 * block + np.arange(40) / 20)
            rows[:, 13] += scalar_T
            moments = likelihood.moments(rows[:, 1:13].reshape(-1, 4, 3), rows[:, 13])
            trial = trial.after(moments, beliefs[1], likelihood)
        assert trial.is_over and trial.blocks >= TRIED
        return trial

    return tried


def test_what_predicts_better_passes(after, true_errors):
    """The truth beside a bias of 10 nT, and not the other way round."""
    wrong = moved(true_errors, 2, bias_T=np.array([10e-9, 0, 0]))
    trial = after(true_errors, wrong)
    assert trial.has_passed and trial.blocks == TRIED
    assert not after(wrong, true_errors).has_passed


def test_where_blocks_are_not_clear_more_of_them_are_tried(after, true_errors):
    """Six tenths of a nanotesla are not clear in six seconds of 20 Hz, but within a minute."""
    trial = after(true_errors, moved(true_errors, 2, bias_T=np.array([0.6e-9, 0, 0])))
    assert trial.has_passed and TRIED < trial.blocks < MOST_TRIED


def test_what_nobody_would_notice_is_not_published(after, true_errors):
    """Three tenths of a nanotesla in one axis, a part in two hundred of the squared residuals."""
    trial = after(true_errors, moved(true_errors, 2, bias_T=np.array([0.3e-9, 0, 0])))
    assert not trial.has_passed and trial.blocks == MOST_TRIED


def test_what_the_scalar_alone_says_is_not_published(after, true_errors):
    """Scale factors of all sensors that explain a scalar reading too much by 5 nT: the sensors agree as well before."""
    larger = replace(true_errors, scale_factor=0.9999 * true_errors.scale_factor)
    trial = after(larger, true_errors, scalar_T=5e-9)
    assert trial.fall.sum() > CLEARLY_BETTER and not trial.has_passed
