"""Spherical harmonics of directions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.harmonics import derivatives, fields, harmonics
from tam_calibration.model.array import UNIT_TENSORS


def test_harmonics_are_orthonormal():
    """On a grid that integrates them exactly their products are those of the unit matrix."""
    node, weight = np.polynomial.legendre.leggauss(8)
    azimuth = 2 * np.pi * np.arange(16) / 16
    z, phi = (grid.ravel() for grid in np.meshgrid(node, azimuth, indexing="ij"))
    direction = np.column_stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z])
    function = harmonics(direction, 6)
    product = function.T @ (function * np.repeat(weight, 16)[:, None]) * 2 * np.pi / 16
    assert_allclose(product, np.eye(49), atol=1e-13)


POSITIONS = np.random.default_rng(1).normal(size=(3, 7))


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_the_fields_have_no_curl_and_no_divergence(degree):
    """Their Jacobians are symmetric and without trace."""
    step = 1e-5 * np.eye(3)
    change = [fields(degree, POSITIONS + move[:, None]) - fields(degree, POSITIONS - move[:, None]) for move in step]
    jacobian = np.stack(change, axis=2)
    assert_allclose(jacobian, np.swapaxes(jacobian, 1, 2), atol=1e-14)
    assert_allclose(np.einsum("paan->pn", jacobian), 0, atol=1e-14)


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_they_are_independent(degree):
    """None is a sum of the others, and they grow with their power of the distance."""
    assert np.linalg.matrix_rank(fields(degree, POSITIONS).reshape(2 * degree + 1, -1)) == 2 * degree + 1
    assert_allclose(fields(degree, 2 * POSITIONS), 2 ** (degree - 1) * fields(degree, POSITIONS))


def test_those_of_degree_two_are_the_gradient():
    """Their coefficients are components of the gradient tensor."""
    order = [derivatives(2).index(orders) for orders in ((2, 0, 0), (1, 1, 0), (1, 0, 1), (0, 2, 0), (0, 1, 1))]
    assert_allclose(fields(2, POSITIONS)[order], UNIT_TENSORS @ POSITIONS)
