"""What happens to the array, as far as it is known."""

from dataclasses import replace

import numpy as np
import pytest


@pytest.mark.parametrize(("steps", "is_hole"), [(2.1, False), (4.2, True)])
def test_a_step_of_several_times_the_usual_one_is_a_hole(turning, steps, is_hole):
    """Two steps are a sample that was lost, four are the end of a stretch."""
    covariates = turning(samples=50)
    later = covariates.time_s + np.where(np.arange(50) >= 30, (steps - 1) * covariates.step_s, 0.0)
    found = replace(covariates, time_s=later).stretches
    assert [(one.start, one.stop) for one in found] == ([(0, 30), (30, 50)] if is_hole else [(0, 50)])
