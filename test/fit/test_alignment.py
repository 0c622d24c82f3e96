import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.moments import into_frame_of_first, procrustes, rotation_by_regression
from tam_calibration.model.exceptions import InputError


def test_procrustes_finds_the_rotation():
    """Fields turned by known rotations give them back."""
    rotation = Rotation.from_quat(np.random.default_rng(1).normal(size=(4, 4))).as_matrix()
    reference = np.random.default_rng(2).normal(size=(5, 3))
    fields = np.einsum("kij,nj->nki", rotation, reference)
    assert_allclose(procrustes(np.einsum("nki,nj->kij", fields, reference)), rotation, atol=1e-14)


def test_regression_gives_a_rotation_back():
    """From an exact rotation the angles one by one are the whole of it."""
    rotation = Rotation.from_euler("XYZ", np.random.default_rng(3).uniform(-1, 1, (4, 3))).as_matrix()
    assert_allclose(rotation_by_regression(np.swapaxes(rotation, 1, 2)), rotation, atol=1e-14)


def test_regression_says_what_it_cannot_find():
    """A sensor that is turned by more than 80 degrees is named, not given a wrong angle."""
    most, more = (Rotation.from_euler("z", angle, degrees=True).as_matrix()[None] for angle in (79.9, 80.1))
    assert_allclose(rotation_by_regression(np.swapaxes(most, 1, 2)), most, atol=1e-14)
    with pytest.raises(InputError, match="sensor 1 is turned by more than 80°"):
        rotation_by_regression(more)


def test_the_common_frame_becomes_that_of_the_first():
    """After the turn the first matrix is upper triangular and the others keep their place against it."""
    matrix = np.random.default_rng(4).normal(size=(2, 3, 3, 3)) + 5 * np.eye(3)
    turned = into_frame_of_first(matrix)
    assert_allclose(np.tril(turned[:, 0], -1), 0, atol=1e-14)
    assert_allclose(np.linalg.solve(turned[:, 0], turned[:, 1]).trace(axis1=1, axis2=2),
                    np.linalg.solve(matrix[:, 0], matrix[:, 1]).trace(axis1=1, axis2=2), rtol=1e-12)  # fmt: skip
