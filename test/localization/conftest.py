import numpy as np
import pytest


@pytest.fixture
def slope():
    """Return central differences of sixth order of a function of three numbers, as columns."""

    def slope(function, point, step):
        weights = np.array([45, -9, 1]) / (60 * step)
        columns = [
            sum(
                w * (function(point + n * step * axis) - function(point - n * step * axis))
                for n, w in enumerate(weights, 1)
            )
            for axis in np.eye(3)
        ]
        return np.stack(columns, axis=-1)

    return slope


def outputs_of(source, points_m=(0, 0, 0)):
    """Return the eight outputs of an array of no extent at a place."""
    point = np.asarray(points_m, dtype=float)
    return np.concatenate([source.field_T(point), source.gradient_T_per_m(point)[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]])
