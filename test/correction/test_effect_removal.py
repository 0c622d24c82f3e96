"""Samples as they arrive are those that a recording without its effects has."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.correction.calibration import EffectSize
from tam_calibration.correction.partial import EffectRemoval
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.fitted_effect import Contribution, FittedEffect

DRIFT = FittedEffect(
    "temperature_drift",
    {"time_constant_s": 0.5, "reference_C": 20.0},
    (Contribution(1, 0, "offset", {"offset": 1e-9}),),
)
LATE = FittedEffect("time_skew", {}, (Contribution(2, None, "delay", {"delay": 1e-3}),))
SIZE = EffectSize(np.full(9, 3e-9), np.full(9, 1e-10))


@pytest.fixture(scope="module")
def warming(recording):
    """Return 100 samples whose temperature rises, unknown in every tenth."""
    warming = np.linspace(15, 25, 100)
    warming[::10] = np.nan
    return replace(recording.take(slice(100)), temperature_C=warming)


@pytest.fixture(scope="module")
def plain(recording, cross):
    """Return a calibration without effects."""
    return maximum_likelihood(recording, cross)


def test_an_effect_is_taken_off_batch_by_batch(plain, warming):
    """As off the recording; a sample whose temperature is not known is left out."""
    keeping = replace(plain, effects=(DRIFT,), effect_sizes=(SIZE,))
    removal = EffectRemoval(keeping)
    parts = [removal.of(warming.take(slice(first, first + 20))) for first in range(0, 100, 20)]
    known = np.isfinite(warming.temperature_C)
    expected = keeping.readings_without_effects(warming.take(known))
    assert_allclose(np.concatenate([part.readings_T for part in parts]), expected, rtol=1e-12)
    assert np.abs(expected - warming.take(known).readings_T).max() > 3e-9


def test_without_effects_samples_stay_as_they_are(plain, warming):
    """Also those whose temperature is not known."""
    assert EffectRemoval(plain).of(warming) is warming


def test_an_effect_that_needs_later_samples_is_refused(plain):
    """One sentence names it and what would mend it."""
    with pytest.raises(InputError, match=r"time_skew, which needs later samples.*use a calibration without it"):
        EffectRemoval(replace(plain, effects=(LATE,), effect_sizes=(SIZE,)))
