"""The sources of many samples, whoever located them: reasons, distances, and pieces that make the whole."""

from dataclasses import fields

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.localization.solutions import EulerSolutions, Status, in_pieces
from tam_calibration.model.recording import BLOCK


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


@pytest.mark.parametrize("count", [BLOCK, BLOCK + 1, 2 * BLOCK + 5])
@pytest.mark.parametrize("each_has_its_own", [True, False])
def test_pieces_make_the_whole(count, each_has_its_own):
    """Every sample is located once, in its place, with its own covariance; more than a piece holds in several."""
    outputs = np.arange(count * 8.0).reshape(count, 8)
    covariance = np.arange(count)[:, None, None] * np.eye(8) if each_has_its_own else np.eye(8)
    sizes = []

    def locate(part, own):
        sizes.append(len(part))
        spread = np.broadcast_to(own, (len(part), 8, 8))[:, :3, :3]
        return EulerSolutions(part[:, :3], spread, part[:, 3:6], spread, part[:, 7].astype(int))

    found = in_pieces(locate, outputs, covariance)
    assert sum(sizes) == count and max(sizes) <= BLOCK and len(sizes) == -(-count // BLOCK)
    assert_allclose(found.position_m, outputs[:, :3])
    assert_allclose(found.moment_Am2, outputs[:, 3:6])
    assert found.status.tolist() == outputs[:, 7].astype(int).tolist()
    expected = np.broadcast_to(covariance, (count, 8, 8))[:, :3, :3]
    assert_allclose(found.position_covariance_m2, expected)
