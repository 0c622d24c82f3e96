from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import require_one_calibration
from tam_calibration.fit.ellipsoid import sphere_of_most
from tam_calibration.model.exceptions import Refused


def test_sphere_of_most_ignores_the_others():
    """With three tenths of the points on another sphere the first one is found."""
    generator = np.random.default_rng(3)
    directions = generator.standard_normal((1000, 3))
    points = np.array([0.1, -0.2, 0.05]) + directions / np.linalg.norm(directions, axis=1, keepdims=True)
    points[300:600] += [0.0, 0.5, 0.4]
    center, radius = sphere_of_most(points)
    assert_allclose(center, [0.1, -0.2, 0.05], atol=1e-3)
    assert radius == pytest.approx(1.0, abs=1e-3)


def test_an_intensity_that_is_not_of_the_earth_is_told_in_microtesla(wu_run, wu_scenario):
    """Beside the range that it should lie in."""
    calibration = replace(calibrate(wu_run.recording, wu_scenario.array), intensity_T=250e-6)
    with pytest.raises(Refused, match="the fitted intensity of 250 µT is outside"):
        require_one_calibration(wu_run.recording, calibration)
