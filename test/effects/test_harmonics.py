"""Spherical harmonics of directions."""

import numpy as np
from numpy.testing import assert_allclose

from tam_calibration.effects.harmonics import harmonics


def test_harmonics_are_orthonormal():
    """On a grid that integrates them exactly their products are those of the unit matrix."""
    node, weight = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * np.pi * np.arange(16) / 16
    z, phi = (grid.ravel() for grid in np.meshgrid(node, azimuth, indexing="ij"))
    direction = np.column_stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z])
    function = harmonics(direction, 6)
    product = function.T @ (function * np.repeat(weight, 16)[:, None]) * 2 * np.pi / 16
    assert_allclose(product, np.eye(49), atol=1e-13)
