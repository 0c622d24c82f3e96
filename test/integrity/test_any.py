"""Whatever numbers a recording may hold, they are judged without an error and without a warning of numpy."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tam_calibration.integrity.check import faults_of
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording

VALUES = st.sampled_from([0.0, -0.0, 1e-300, 5e-324, -1e-12, 3e-5, -4e-5, 1.0, -1e8, 1e9])


@given(st.data(), st.integers(20, 40), st.integers(1, 3), st.booleans())
def test_any_numbers(data, count, sensors, has_scalar):
    """Zeros, the smallest numbers that there are and the largest that are taken, beside usual ones."""
    rng = np.random.default_rng(data.draw(st.integers(0, 2**32 - 1)))
    few = np.array(data.draw(st.lists(VALUES, min_size=1, max_size=5)))
    readings = rng.choice(few, (count, sensors, 3))
    usual = rng.random((count, sensors, 3)) < data.draw(st.floats(0, 1))
    readings[usual] = 3e-5 * rng.normal(size=usual.sum())
    scalar = rng.choice(few, count) if has_scalar else None
    attitude = rng.choice([0.5, np.nan], (count, 1)) * np.ones((count, 4)) if data.draw(st.booleans()) else None
    recording = Recording(np.arange(count) / 10, readings, scalar, attitude=attitude)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for fault in faults_of(recording, Array(np.zeros((sensors, 3)), np.full(sensors, 1e-9))):
            assert fault.sentence and "nan" not in fault.sentence


@pytest.mark.parametrize("scale", [1e-300, 1e-150, 1e3, 1e8])
def test_any_unit(run, scale):
    """A whole run too small or too large to be squared, and one sensor of it, which is named."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        faults_of(replace(run.recording, readings_T=scale * 1e5 * run.recording.readings_T), run.array)
        told = run.spoiled(lambda readings: readings.__setitem__((slice(None), 1), scale * readings[:, 1])).told
        assert told == [("unit", 2, "")]
