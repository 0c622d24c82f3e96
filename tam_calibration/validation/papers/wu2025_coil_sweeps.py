"""Which error that the model of Wu 2025 leaves out is needed for the printed localisation errors of the coil.

Each is grown until the distance is as wrong as printed after calibration, for many directions of the coil and, where
the error has no one shape, for many shapes.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import permutations

import numpy as np
from numpy.linalg import norm

from tam_calibration.model.units import FloatArray, from_degrees
from tam_calibration.validation.papers.wu2025_coil import AXES, PRINTED_M, Experiment, Fault, directions

_STAGE = "after"
_DIRECTIONS, _DRAWS = 24, 24
_SENSORS = 4


@dataclass(frozen=True, eq=False)
class CoilSweep:
    """The localisation errors over the size of one error.

    Parameters
    ----------
    name, unit : str
        What grows, for people, and the unit of its size.
    size : (V,) array
        In that unit.
    rmse_m : (V, S, 4) array
        Errors of ``wu2025_coil.AXES`` after calibration, for S directions of the coil and shapes of the error.
    """

    name: str
    unit: str
    size: FloatArray
    rmse_m: FloatArray

    @property
    def distance_rmse_m(self) -> FloatArray:
        """(V, 3) errors of the distance: least, median and largest of all directions and shapes."""
        quantiles: FloatArray = np.quantile(self.rmse_m[..., AXES.index("r")], [0, 0.5, 1], axis=1).T
        return quantiles

    @property
    def needed(self) -> float:
        """The smallest size at which the median error of the distance is the printed one; NaN where it never is."""
        printed, median = PRINTED_M[_STAGE]["r"], self.distance_rmse_m[:, 1]
        crossings = [
            np.interp(printed, median[pair], self.size[pair])
            for first in range(len(self.size) - 1)
            for pair in [np.array([first, first + 1])[np.argsort(median[first : first + 2])]]
            if median[pair[0]] <= printed <= median[pair[1]]
        ]
        return float(min(crossings, key=abs)) if crossings else float("nan")


def sweeps(experiment: Experiment) -> list[CoilSweep]:
    """Return a sweep over each error that the model leaves out."""
    outwards = experiment.array.positions_m / norm(experiment.array.positions_m, axis=1, keepdims=True)
    stacks = [np.array(order, dtype=float) - 1 for order in permutations(range(3))]
    parallel = [
        np.repeat((place[:, None] * direction)[None], _SENSORS, axis=0) for place in stacks for direction in np.eye(3)
    ]
    radial = [place[:, None] * outwards[:, None] for place in stacks]
    draws = list(np.random.default_rng(0).standard_normal((_DRAWS, _SENSORS, 3)))
    axial = [np.broadcast_to(draw[:1], draw.shape) for draw in draws]
    percent = np.linspace(0, 10, 11)
    return [
        _sweep(
            experiment,
            "baseline length",
            "%",
            np.linspace(-20, 20, 21),
            [np.zeros(1)],
            lambda size, _: Fault(1 + size / 100),
        ),
        _sweep(experiment, "spacing of the axes, sensors in parallel", "mm", np.linspace(0, 50, 6), parallel, _spacing),
        _sweep(
            experiment, "spacing of the axes, sensors along their arms", "mm", np.linspace(0, 50, 11), radial, _spacing
        ),
        _sweep(experiment, "gain at 10 Hz, each axis of each sensor", "% (1σ)", percent, draws, _gain),
        _sweep(experiment, "gain at 10 Hz, each axis, sensors alike", "% (1σ)", percent, axial, _gain),
        _sweep(
            experiment,
            "headings",
            "°",
            np.linspace(0, 20, 6),
            [np.zeros(1)],
            lambda size, _: Fault(heading=from_degrees(size)),
        ),
    ]


def _spacing(size: float, shape: FloatArray) -> Fault:
    return Fault(axis_offsets_m=1e-3 * size * shape)


def _gain(size: float, shape: FloatArray) -> Fault:
    return Fault(gain=1 + size / 100 * shape)


def _sweep(
    experiment: Experiment,
    name: str,
    unit: str,
    size: FloatArray,
    shapes: Sequence[FloatArray],
    make: Callable[[float, FloatArray], Fault],
) -> CoilSweep:
    axes = directions(_DIRECTIONS)
    rmse = [[experiment.rmse_m(_STAGE, axes, make(value, shape)) for shape in shapes] for value in size]
    return CoilSweep(name, unit, size, np.array(rmse).reshape(len(size), -1, len(AXES)))
