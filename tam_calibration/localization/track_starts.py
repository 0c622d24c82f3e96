"""Where a fit of dipoles to a passage begins: where Euler's equation sees them, round the path, or by splitting one."""

from collections.abc import Callable
from dataclasses import replace
from itertools import combinations

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import scaled
from tam_calibration.localization.euler import locate
from tam_calibration.localization.passage import GRADIENT, OF_SOURCE, UNIFORM, VELOCITY, Passage
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, tensors_of
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field

_STARTS = 24
"""Places along the path that are tried as those of sources: all sets of them, of which the best are fitted."""

_DISTANCES = 3.0 * 1.5 ** np.arange(7)
"""From the path, in arm's lengths of the array, at which a further source is looked for: nearer and farther ones are
seen from there too."""

_GOLDEN = (1 + np.sqrt(5)) / 2
_DIRECTIONS = np.array(
    [np.roll([0.0, one, other], turn) for turn in range(3) for one in (-1, 1) for other in (-_GOLDEN, _GOLDEN)]
) / np.hypot(1, _GOLDEN)
"""In which it is looked for: the corners of an icosahedron."""

_APART = 0.4
"""Part of a source's distance from the path by which it is split into two: a pair that is nearer is seen as one."""

_MOST_BESIDE = 3
"""Starts of a further source that are fitted: the best places along the path are often those of one source."""


def without_source(passage: Passage) -> FloatArray:
    """Return the regional field and gradient that most samples have in the world, and what else is expected.

    Parameters
    ----------
    passage : Passage
        What was read.

    Returns
    -------
    (P,) array
        What is free of u, G and δv.
    """
    outputs = _outputs(passage, passage.readings_T)
    turn, full = passage.matrix, passage.known.expected.copy()
    tensor = np.median(turn @ tensors_of(outputs) @ np.swapaxes(turn, 1, 2), axis=0)
    uniform = np.median((turn @ outputs[:, :3, None])[..., 0] - passage.path_m @ tensor, axis=0)
    full[UNIFORM], full[GRADIENT] = uniform, tensor[TENSOR_ROWS, TENSOR_COLUMNS]
    free = passage.known.is_free
    unknown: FloatArray = full[free]
    return unknown


def starts(passage: Passage, unknowns: FloatArray, count: int) -> list[FloatArray]:
    """Return the best starts (P,) of so many sources: places that Euler's equation sees, moments by least squares.

    The moments are found as those of dipoles. One source has one start, two have four: what they make is less alike.


    Parameters
    ----------
    passage : Passage
        What was read, and of which sources.
    unknowns : (P,) array
        What is free of u, G and δv, without any source.
    count : int
        Number of sources.

    Raises
    ------
    Refused
        When fewer places are seen.
    """
    passage = replace(passage, kernel=dipole_field)
    places = _places(passage, unknowns)
    if len(places) < count:
        raise Refused("the field or its gradient is zero in every pose: there is no source to be seen")
    tried, moments = _resting(places, unknowns)
    regional = len(tried) - len(unknowns) + np.arange(len(unknowns) - int(passage.known.is_free[VELOCITY].sum()))
    sets = [np.array(chosen) for chosen in combinations(range(len(places)), count)]
    columns = np.array([np.concatenate([moments[chosen].ravel(), regional]) for chosen in sets])
    gain, change = _gains(passage, tried, columns)
    starts = []
    for at in np.argsort(-gain, kind="stable")[: count**2]:
        start = tried.copy()
        start[columns[at]] += change[at]
        of_sources, rest = np.split(start, [len(tried) - len(unknowns)])
        starts.append(np.concatenate([of_sources.reshape(-1, OF_SOURCE)[sets[at]].ravel(), rest]))
    return starts


def starts_beside(passage: Passage, unknowns: FloatArray) -> list[FloatArray]:
    """Return the best starts (P + 6,) of one more dipole beside the sources of unknowns (P,).

    Places all round the path are tried: Euler's equation sees none where errors of the attitude are left. Its moment is
    that by which χ² falls most where the unknowns change with it, to first order.


    Parameters
    ----------
    passage : Passage
        What was read, and of which sources.
    unknowns : (P,) array
        Places and moments of the sources so far, and what is free of u, G and δv.
    """
    arm_m = float(norm(passage.array.positions_m, axis=1).max())
    offsets = (arm_m * _DISTANCES[:, None, None] * _DIRECTIONS).reshape(-1, 3)
    count = len(passage.path_m)
    along = np.linspace(0, count - 1, min(count, _STARTS)).round().astype(int)
    gains_of = _gains_beside(passage, unknowns)
    best: list[tuple[float, FloatArray]] = []
    for center in passage.center_m(unknowns)[along]:
        places = center + offsets
        gain, moment = gains_of(places)
        at = int(np.argmax(gain))
        best.append((float(gain[at]), np.concatenate([places[at], moment[at], unknowns])))
    return [start for _, start in sorted(best, key=lambda each: -each[0])[:_MOST_BESIDE]]


def _gains_beside(passage: Passage, unknowns: FloatArray) -> Callable[[FloatArray], tuple[FloatArray, FloatArray]]:
    """Return a function from places (n, 3) to the fall of χ² (n,) by a dipole there, and its moment (n, 3).

    The data are linear in the moment; what they share with the other unknowns is projected out once for all places.
    """
    points, weights = passage.seen(unknowns)
    predicted, slopes = passage.predict(unknowns)
    normal, scale = scaled(slopes.T @ slopes)
    inverse = np.linalg.pinv(normal, hermitian=True)
    residuals, others = passage.whitened(unknowns)
    others = others.reshape(-1, len(scale)) / scale
    left = residuals.ravel() - others @ (inverse @ (slopes.T @ (passage.data - predicted) / scale))

    def gains(places: FloatArray) -> tuple[FloatArray, FloatArray]:
        _, _, by_moment = passage.kernel(points[:, None] - places[:, None], np.zeros(3))
        stacked = np.moveaxis(by_moment, 1, 3).reshape(len(points), -1, by_moment[0, :, 0, 0].size)
        columns = (weights @ stacked).reshape(len(left), len(places), 3).transpose(1, 2, 0)
        across = columns @ others
        own, size = scaled(columns @ columns.swapaxes(1, 2) - across @ inverse @ across.swapaxes(1, 2))
        slope = columns @ left / size
        moment = (np.linalg.pinv(own, hermitian=True) @ slope[..., None])[..., 0]
        return np.sum(moment * slope, axis=1), moment / size

    return gains


def starts_split(passage: Passage, unknowns: FloatArray) -> list[FloatArray]:
    """Return starts (P + 6,) with one of the sources of unknowns (P,) as two halves beside each other, along each axis.

    Two dipoles that are near to each other are fitted as one between them, and no place elsewhere leads to them.


    Parameters
    ----------
    passage : Passage
        What was read, and of which sources.
    unknowns : (P,) array
        As for ``starts_beside``.
    """
    center, starts = passage.center_m(unknowns), []
    for number, source in enumerate(passage.sources(unknowns)):
        distance = norm(center - source[:3], axis=1).min()
        for axis in np.eye(3):
            shift = np.concatenate([_APART / 2 * distance * axis, -source[3:] / 2])
            start = unknowns.copy()
            start[OF_SOURCE * number : OF_SOURCE * (number + 1)] += shift
            starts.append(np.concatenate([source - shift * np.repeat([1.0, -1.0], 3), start]))
    return starts


def _resting(places: FloatArray, unknowns: FloatArray) -> tuple[FloatArray, np.ndarray]:
    """Return unknowns with dipoles without moment at places (n, 3) before them, and where the moments (n, 3) stand."""
    sources = np.column_stack([places, np.zeros_like(places)]).ravel()
    return np.concatenate([sources, unknowns]), np.arange(sources.size).reshape(-1, OF_SOURCE)[:, 3:]


def _gains(passage: Passage, tried: FloatArray, columns: np.ndarray) -> tuple[FloatArray, FloatArray]:
    """Return by how much χ² falls (M,) where sets (M, C) of unknowns change, and these changes, to first order."""
    predicted, slopes = passage.predict(tried)
    normal, scale = scaled(slopes.T @ slopes)
    slope = slopes.T @ (passage.data - predicted) / scale
    inverse = np.linalg.pinv(normal[columns[:, :, None], columns[:, None]], hermitian=True)
    change = (inverse @ slope[columns][..., None])[..., 0]
    return np.sum(change * slope[columns], axis=1), change / scale[columns]


def _places(passage: Passage, unknowns: FloatArray) -> FloatArray:
    """Return the places (n, 3) in the world at which Euler's equation sees what unknowns leave, all along the path."""
    outputs = _outputs(passage, passage.left_T(unknowns))
    solutions = locate(outputs)
    located = np.flatnonzero(solutions.is_located)
    strongest = located[np.argsort(-norm(outputs[located, 3:], axis=1), kind="stable")]
    groups = np.array_split(np.sort(strongest[: len(strongest) // 2 + 1]), _STARTS)
    chosen = np.array([group[np.argmax(norm(outputs[group, 3:], axis=1))] for group in groups if len(group)], dtype=int)
    offsets = (passage.matrix[chosen] @ solutions.position_m[chosen, :, None])[..., 0]
    places: FloatArray = passage.path_m[chosen] + offsets
    return places


def _outputs(passage: Passage, readings_T: FloatArray) -> FloatArray:
    """Return the field and gradient (N, 9) of readings (N, K, 3)."""
    outputs: FloatArray = readings_T.reshape(len(readings_T), -1) @ passage.array.operator.T
    return outputs
