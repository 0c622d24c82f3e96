"""The sources of many samples, whoever located them: reasons and distances.

What a survey tells: its standard errors, and a survey without a source is refused.
"""

from dataclasses import fields

import numpy as np
import pytest

from tam_calibration.localization.solutions import (
    WORLD_FRAME,
    EulerSolutions,
    Status,
    Survey,
    standard_errors,
)
from tam_calibration.model.exceptions import Refused


def test_every_status_but_located_says_what_would_mend_it():
    """Their numbers stay what they are: messages and files hold them."""
    names = "LOCATED NOT_FINITE NO_FIELD NO_GRADIENT ILL_CONDITIONED AMBIGUOUS UNCERTAIN NO_ATTITUDE NO_REGIONAL APART"
    names += " MISFIT"
    assert [(each.name, int(each)) for each in Status] == [(name, at) for at, name in enumerate(names.split())]
    assert Status.LOCATED.reason == ""
    assert len({each.reason for each in Status}) == len(Status)


def test_refused_samples_have_nothing_but_their_reason():
    """No place, no moment, no direction, and no covariance of any; each its own array."""
    refused = EulerSolutions.refused(3, Status.NO_FIELD)
    values = [getattr(refused, field.name) for field in fields(EulerSolutions)]
    assert [value.shape for value in values] == [(3, 3), (3, 3, 3), (3, 3), (3, 3, 3), (3,), (3,), (3, 3)]
    assert all(np.isnan(value).all() for value in (*values[:4], *values[5:]))
    assert refused.status.tolist() == [Status.NO_FIELD] * 3 and not refused.is_located.any()
    refused.position_m[:], refused.position_covariance_m2[:] = 1.0, 1.0
    assert np.isnan(refused.moment_Am2).all() and np.isnan(refused.moment_covariance_A2m4).all()


def test_nothing_located_is_refused_with_the_most_common_reason():
    """A survey has a source, or is none."""
    solutions = EulerSolutions.refused(4, Status.NO_FIELD)
    solutions.status[0] = Status.AMBIGUOUS
    with pytest.raises(Refused, match="in 3 of 4 samples the field of the source is zero"):
        Survey(WORLD_FRAME, np.arange(4.0), solutions)


def test_a_single_sample_is_refused_by_its_own_reason():
    """It is not told as one of one."""
    with pytest.raises(Refused, match="in the sample the gradient tensor is zero"):
        Survey(WORLD_FRAME, np.zeros(1), EulerSolutions.refused(1, Status.NO_GRADIENT))


def test_refusals_are_counted_by_their_reason():
    """Samples that were located are none."""
    solutions = EulerSolutions.refused(5, Status.UNCERTAIN)
    solutions.status[[0, 3]] = Status.LOCATED, Status.AMBIGUOUS
    survey = Survey(WORLD_FRAME, np.arange(5.0), solutions)
    assert survey.refusals == {Status.UNCERTAIN: 3, Status.AMBIGUOUS: 1}


@pytest.mark.parametrize("shape", [(), (4,), (2, 5)])
def test_standard_errors_are_the_roots_of_each_diagonal(shape):
    """Of one covariance, or of as many as there are."""
    roots = np.random.default_rng(4).normal(size=(*shape, 3, 3))
    errors = standard_errors(roots @ np.swapaxes(roots, -1, -2))
    assert errors.shape == (*shape, 3)
    assert errors == pytest.approx(np.sqrt(np.sum(roots**2, axis=-1)))
