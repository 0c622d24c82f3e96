import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from tam_calibration.fit.moments import rotation_by_regression
from tam_calibration.model.exceptions import InputError


def test_regression_says_what_it_cannot_find():
    """A sensor that is turned by more than 80 degrees is named, not given a wrong angle."""
    most, more = (Rotation.from_euler("z", angle, degrees=True).as_matrix()[None] for angle in (79.9, 80.1))
    assert_allclose(rotation_by_regression(np.swapaxes(most, 1, 2)), most, atol=1e-14)
    with pytest.raises(InputError, match="sensor 1 is turned by more than 80°"):
        rotation_by_regression(more)
