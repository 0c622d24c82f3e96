"""A map of the field over survey lines: the anomaly of the intensity, and the contraction of the gradient tensor."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tam_calibration.localization.targets import SurveyLine
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

_CELL_M, _MOST_CELLS = 0.5, 1000
"""Size of the cells, metres: a sixth of the depth of the nearest targets. Along a side there are at most so many."""

_REACH_M = 10.0
"""Distance from the nearest sample beyond which cells stay empty, metres: lines farther apart than twice this say
nothing of the field between them."""


@dataclass(frozen=True, eq=False)
class FieldMap:
    """A regular grid, interpolated linearly between the samples of lines; NaN where none is near.

    Parameters
    ----------
    x_m, y_m : (X,) and (Y,) arrays
        Middles of the cells, metres.
    anomaly_T : (Y, X) array
        Intensity less its median over all lines, tesla.
    contraction_T_per_m : (Y, X) array
        Square root of the contraction of the gradient tensor, T/m.
    """

    x_m: FloatArray
    y_m: FloatArray
    anomaly_T: FloatArray
    contraction_T_per_m: FloatArray


def require_area(paths_m: Sequence[FloatArray]) -> None:
    """Check that paths (N, 3), metres, do not lie on one straight line.

    Raises
    ------
    InputError
        When they do.
    """
    places = np.concatenate(paths_m)[:, :2]
    if np.linalg.svd(places - places.mean(axis=0), compute_uv=False)[1] < _CELL_M * np.sqrt(len(places)):
        raise InputError("a map needs lines beside each other: all samples lie on one straight line; leave out --grid")


def field_map(lines: Sequence[SurveyLine]) -> FieldMap:
    """Return the map of survey lines beside each other, positions in one world."""
    from scipy.interpolate import LinearNDInterpolator
    from scipy.spatial import KDTree

    places = np.concatenate([each.center_m[:, :2] for each in lines])
    intensity = np.concatenate([each.intensity_T for each in lines])
    contraction = np.concatenate([each.contraction_T_per_m for each in lines])
    low, high = places.min(axis=0), places.max(axis=0)
    cell = max(_CELL_M, float((high - low).max()) / _MOST_CELLS)
    x, y = (np.arange(first, last + cell, cell) for first, last in zip(low, high, strict=True))
    at = np.stack(np.meshgrid(x, y), axis=-1)
    values = LinearNDInterpolator(places, np.column_stack([intensity - np.median(intensity), contraction]))(at)
    values[KDTree(places).query(at)[0] > _REACH_M] = np.nan
    return FieldMap(x, y, values[..., 0], values[..., 1])
