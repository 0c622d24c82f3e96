import numpy as np

EARTH_T = np.array([1e-6, 2e-5, -4.5e-5])


def outputs_of(source, points_m=(0, 0, 0)):
    """Return the eight outputs of an array of no extent at a place."""
    point = np.asarray(points_m, dtype=float)
    return np.concatenate([source.field_T(point), source.gradient_T_per_m(point)[[0, 0, 0, 1, 1], [0, 1, 2, 1, 2]]])
