import numpy as np
import pytest
from numpy.testing import assert_allclose

from tam_calibration.core.least_squares import Normal, gram, ridged


@pytest.mark.parametrize("shape", [(1, 5), (13, 1), (11, 20_000), (48, 1001)])
def test_it_is_the_sum_of_the_outer_products(shape):
    """Whatever the size, the sum is that of one product, and as symmetric."""
    columns = np.random.default_rng(2).normal(size=shape)
    found = gram(columns)
    assert_allclose(found, columns @ columns.T, rtol=1e-10, atol=1e-10)
    assert_allclose(found, found.T, rtol=1e-12, atol=1e-10)


@pytest.mark.parametrize("unit", [1e-20, 1.0, 1e20])
def test_a_ridge_is_a_billionth_of_the_mean_information_in_each_direction(unit):
    """In any unit, and of each of several matrices by itself."""
    information = unit * np.array([np.diag([1.0, 2.0, 6.0]), np.diag([10.0, 20.0, 60.0])])
    means = unit * np.array([3.0, 30.0])
    assert_allclose(ridged(information) - information, 1e-9 * means[:, None, None] * np.eye(3), rtol=1e-5)


def test_a_matrix_of_zeros_gets_a_ridge_of_a_billionth():
    """So that it has an inverse, and a score of zero no value."""
    assert_allclose(ridged(np.zeros((2, 3, 3))), np.broadcast_to(1e-9 * np.eye(3), (2, 3, 3)))


def test_equations_of_parts_add_up_to_those_of_the_whole():
    """And those of the whole less a part are those of the rest."""
    generator = np.random.default_rng(3)
    columns, channels = generator.normal(size=(4, 30)), generator.normal(size=30)

    def of(part):
        x, y = columns[:, part], channels[part]
        return Normal(x @ x.T, x @ y, float(y @ y), float(y.size))

    first, last, whole = of(slice(0, 11)), of(slice(11, 30)), of(slice(0, 30))
    for found, expected in ((first + last, whole), (whole - first, last)):
        assert_allclose(found.information, expected.information, atol=1e-12)
        assert_allclose(found.score, expected.score, atol=1e-12)
        assert (found.energy, found.count) == (pytest.approx(expected.energy), expected.count)
