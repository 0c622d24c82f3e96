"""A run whose samples are of several sources, or of none at rest, is refused by what they leave and how they differ."""

import numpy as np
import pytest

from tam_calibration.localization.one_source import require_one_source
from tam_calibration.localization.solutions import EulerSolutions, Status
from tam_calibration.model.exceptions import Refused

MOMENT_AM2 = np.array([50.0, -80.0, 120.0])


def of_moments(moments_Am2, error_Am2, chi_square=2.0):
    """Return solutions along the axes of the world with moments (N, 3), all of one standard error, that fit so well."""
    count = len(moments_Am2)
    own = EulerSolutions.refused(count, Status.LOCATED)
    own.moment_Am2[:] = moments_Am2
    own.moment_covariance_A2m4[:] = error_Am2**2 * np.eye(3)
    own.chi_square[:] = chi_square
    return own


def test_samples_of_one_dipole_have_one_moment():
    """Moments that differ by their standard errors are of one source; every second other by five is not."""
    alike = MOMENT_AM2 + 5.0 * np.random.default_rng(13).normal(size=(20, 3))
    require_one_source(of_moments(alike, 5.0))
    alike[::2] += [25.0, 0.0, 0.0]
    with pytest.raises(Refused, match=r"one dipole at rest .* their moments differ by 1\.\d+ of their standard errors"):
        require_one_source(of_moments(alike, 5.0))


def test_what_a_dipole_leaves_is_told():
    """Twice the noise of 20 samples that have one moment, of which two numbers each are left."""
    same = np.tile(MOMENT_AM2, (20, 1))
    with pytest.raises(Refused, match="what is left is 2 times the noise"):
        require_one_source(of_moments(same, 5.0, chi_square=8.0))


@pytest.mark.parametrize(("errors", "is_told"), [(3.1, True), (2.9, False)])
def test_a_moment_below_three_standard_errors_tells_nothing(errors, is_told):
    """Ten samples that see it are needed."""
    size = np.linalg.norm(MOMENT_AM2)
    own = of_moments(np.tile(MOMENT_AM2, (10, 1)), size / errors / np.sqrt(3))
    if is_told:
        require_one_source(own)
        return
    with pytest.raises(Refused, match="only 0 samples are located so well that one source is told from several"):
        require_one_source(own)


def of_directions(angles):
    """Return solutions of lines that are turned by angles (N,) out of one direction, either way, known to 0.01 rad."""
    angles = np.asarray(angles)
    own = of_moments(np.full((len(angles), 3), np.nan), np.nan)
    along = np.column_stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)])
    own.along[:] = along * np.where(np.arange(len(angles)) % 3, 1, -1)[:, None]
    own.along_covariance[:] = 1e-4 * (np.eye(3) - along[:, :, None] * along[:, None, :])
    return own


@pytest.mark.parametrize("index", [1, 2])
def test_samples_of_one_line_have_one_direction(index):
    """Either way along it, and by up to 2.3 standard errors in common: χ² of three over three at its 99.9 % point."""
    apart = np.tile([0.0, 1.0], 10) * np.sqrt(4 * 2 * 19 / 20) * 0.01
    require_one_source(of_directions(2.32 * apart), index)
    with pytest.raises(Refused, match=r"one line of \w+ at rest .* their directions differ by 2.34 of their standard"):
        require_one_source(of_directions(2.34 * apart), index)


def test_samples_that_are_not_located_are_no_reason():
    """Each has its own."""
    require_one_source(EulerSolutions.refused(12, Status.NO_FIELD))
