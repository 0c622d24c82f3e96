from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit.information import bound
from tam_calibration.fit.published import lossless, two_step_linear


def test_with_a_constant_intensity_the_ellipsoid_is_that_of_wu(wu_run, wu_scenario):
    """Bias, scale factors and non-orthogonality are those of the lossless calibration; the alignment is another."""
    constant = replace(wu_run.recording, scalar_T=np.full(wu_run.recording.sample_count, 54955.83e-9))
    found = two_step_linear(constant, wu_scenario.array).errors.to_vector()
    expected = lossless(constant, wu_scenario.array).errors.to_vector()
    assert_allclose(found[:, :9], expected[:, :9], rtol=0, atol=1e-13)
    assert 1e-8 < np.abs(found - expected)[1:, 9:].max() < 1e-5


def test_the_alignment_reaches_the_bound(wu_runs, wu_scenario):
    """The errors of an ellipsoid's triangular factor do not reach what is regressed below its diagonal."""
    least = bound(wu_runs[0].center_field_T, wu_scenario.errors, wu_scenario.array, has_scalar=True)
    least = np.diag(least).reshape(-1, 12)[1:, 9:]

    def efficiency(method):
        found = [method(run.recording, wu_scenario.array).errors.misalignment for run in wu_runs]
        return np.mean(np.mean(np.square(found - wu_scenario.errors.misalignment), axis=0)[1:] / least)

    assert efficiency(two_step_linear) == pytest.approx(1.0, abs=0.24)
    assert efficiency(lossless) > 1.4
