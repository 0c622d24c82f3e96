"""Noise alone shows none of the effects that are searched for."""

import pytest
from findings import evidence

from tam_calibration.effects.converter import Saturation, find_lattices
from tam_calibration.effects.noise_excess import NoiseExcess, TimingJitter
from tam_calibration.effects.single_samples import InterpolatedSamples, Outliers, StaleSamples

NEVER_FOUND = (InterpolatedSamples(), NoiseExcess(), Saturation(), StaleSamples())
WEIGHED = (Outliers(), TimingJitter())
"""Effects of which something may be found that BIC does not pay for."""


@pytest.mark.parametrize(("samples", "sensors"), [(60, 4), (400, 2), (2000, 4), (300, 12), (2000, 1)])
def test_noise_shows_no_effect(bench, samples, sensors):
    """In motion and in poses, with and without a scalar, ten records whose data sheets are wrong either way."""
    for seed in range(10):
        sheet = (0.8, 0.88, 1.0, 1.12)[seed // 2 % 4]
        residuals = bench(samples, sensors, seed % 3 > 0, seed % 2 == 0, seed, sheet).residuals()
        assert find_lattices(residuals) == []
        for effect in (*NEVER_FOUND, *WEIGHED):
            found = "" if effect.obstacle(residuals.covariates) else effect.find(residuals)
            is_none = isinstance(found, str) or (effect in WEIGHED and evidence(found, residuals) < 0)
            assert is_none, (effect.name, seed)
