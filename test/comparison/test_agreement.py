"""Whether two noises differ whose level and spectrum are known."""

from dataclasses import replace

import numpy as np
import pytest
from coloured_noises import found, shaped

from tam_calibration.comparison import agreement
from tam_calibration.comparison.agreement import differs
from tam_calibration.gap.spectrum import MARGIN


@pytest.mark.parametrize("kind", [None, "flicker", "walk", "relaxing", "band"])
@pytest.mark.parametrize("counts", [(4000, 4000), (1000, 3000)])
def test_noises_of_one_kind_do_not_differ(kind, counts):
    """Whatever their colour and the lengths of the two runs."""
    generator = np.random.default_rng(11)

    def run(count):
        rows = generator.normal(size=(count, 6))
        if kind:
            rows += np.column_stack([shaped(kind, 4000, generator)[:count] for _ in range(6)])
        return found(rows, np.eye(6))

    assert not any(differs(one, other) for one, other in zip(*map(run, counts), strict=True))


@pytest.mark.parametrize("kind", [None, "flicker"])
def test_another_level_differs(kind):
    """A quarter more noise in 4000 samples is told, one per cent never."""
    generator = np.random.default_rng(12)
    rows = generator.normal(size=(4000, 3))
    if kind:
        rows += np.column_stack([shaped(kind, 4000, generator) for _ in range(3)])
    for one, more, hardly in zip(*(found(rows * by, np.eye(3)) for by in (1.0, 1.25, 1.01)), strict=True):
        assert differs(one, more) and differs(more, one) and not differs(one, hardly)


@pytest.mark.parametrize("kind", ["flicker", "relaxing", "band"])
def test_another_colour_of_the_same_level_differs(kind):
    """Half of the variance is coloured in one of the two."""
    generator = np.random.default_rng(13)
    white = generator.normal(size=(4000, 3))
    coloured = generator.normal(size=(4000, 3)) + np.column_stack([shaped(kind, 4000, generator) for _ in range(3)])
    for one, other in zip(*(found(rows / rows.std(axis=0), np.eye(3)) for rows in (white, coloured)), strict=True):
        assert differs(one, other) and differs(other, one)


def test_the_noise_of_a_sample_is_compared_at_other_rates():
    """White noise of equal standard deviations does not differ, though its densities do."""
    rows = np.random.default_rng(14).normal(size=(4000, 3))
    slow = found(rows, np.eye(3), 0.1 * np.arange(4000))
    for one, other in zip(found(rows, np.eye(3)), slow, strict=True):
        assert not differs(one, other)
        assert other.density_T2_per_hz == pytest.approx(5 * one.density_T2_per_hz)


def test_the_limits_of_a_difference():
    """A level differs by more than 5 %, and by more than 4.5 standard errors; strong evidence makes a colour."""
    (one,) = found(np.random.default_rng(15).normal(size=(400, 1)), np.eye(1))
    sure = replace(one, level_error_T=0.0)
    assert (agreement.SLIGHT, agreement.CERTAIN, MARGIN) == (0.05, 4.5, 6.0)
    assert not differs(sure, replace(sure, level_T=1.049 * one.level_T))
    assert differs(sure, replace(sure, level_T=1.051 * one.level_T))
    error = 0.1 * one.level_T
    assert not differs(sure, replace(sure, level_T=np.exp(0.4) * one.level_T, level_error_T=np.exp(0.4) * error))
    assert differs(sure, replace(sure, level_T=np.exp(0.5) * one.level_T, level_error_T=np.exp(0.5) * error))


def test_a_level_that_is_hardly_seen_differs_from_a_large_one():
    """The variance of a quiet scalar is known to what its sensors leave uncertain: its level is 0.003 nT or 0.3."""
    (one,) = found(np.random.default_rng(3).normal(size=(400, 1)), np.eye(1))
    quiet = replace(one, level_T=3e-12, level_error_T=0.3e-9)
    loud = replace(one, level_T=80e-9, level_error_T=7e-9)
    assert differs(quiet, loud) and differs(loud, quiet)
    assert not differs(quiet, replace(one, level_T=0.06e-9, level_error_T=0.015e-9))
