"""As many dipoles as the readings of a passage show, or why they show none that can be told."""

from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, scaled
from tam_calibration.localization.euler import locate
from tam_calibration.localization.misfit import Misfit, misfit_of
from tam_calibration.localization.passage import GRADIENT, UNIFORM, VELOCITY, Passage, solve
from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, tensors_of
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field

MOST_SOURCES = 3
"""Dipoles that are looked for: a fourth has not been needed for a single pass."""

_STARTS = 24
"""Places along the path that are tried as those of sources: all sets of them, of which the best are fitted."""

_COARSE, _ROUGH_STEP = 200, 1e-3
"""Samples at which a fit begins, and the part of a place and a moment below which its steps end then."""

_SIGNAL = 10.0
"""What is read of sources over the noise with which a fit begins."""

_LEAST_GAIN = 60.0
"""Fall of χ² that a further dipole must bring: of six unknowns by noise alone once in 10¹¹, many places tried."""

LARGEST_COLOUR = 4.0
"""Of residuals by which standard errors are still widened; beyond, what is left out moves the source."""

_UNDETERMINED = "the readings do not determine the source: it is too far, too weak, or always seen from the same side"


@dataclass(frozen=True, eq=False)
class TrackFit:
    """Dipoles that were fitted to a passage.

    Parameters
    ----------
    solution : Solution
        Of one problem.
    misfit : Misfit
        What it leaves.
    """

    solution: Solution
    misfit: Misfit

    @property
    def is_found(self) -> bool:
        """Whether the readings determine the dipoles."""
        return bool(self.solution.is_found[0])


def fit_track(passage: Passage) -> TrackFit:
    """Fit one dipole, and further ones for as long as the residuals show one.

    Parameters
    ----------
    passage : Passage
        The readings, of dipoles.

    Raises
    ------
    Refused
        When the readings do not determine the dipoles, or are not those of dipoles, with the reason.
    """
    best = last = _tested(passage, _best_fit(passage, 1))
    nothing = solve(passage, _without_source(passage))
    if float(nothing.chi_square[0]) - float(best.solution.chi_square[0]) < _LEAST_GAIN * best.misfit.variance_factor:
        raise Refused("no dipole is seen: noise beside the regional field explains the readings as well")
    while last.misfit.colour > 1 and _count(passage, last) < MOST_SOURCES:
        try:
            more = _tested(passage, _best_fit(passage, _count(passage, last) + 1))
        except Refused:
            break
        if _gain(last, more) < _LEAST_GAIN:
            break
        last = more
        if more.is_found or not best.is_found:  # one dipole need not settle where there are two
            best = more
    if not best.is_found:
        raise Refused(_UNDETERMINED)
    if best.misfit.colour > LARGEST_COLOUR:
        raise Refused(_reason(_count(passage, best), best.misfit))
    return best


def _count(passage: Passage, fit: TrackFit) -> int:
    return len(passage.sources(fit.solution.unknowns[0]))


def _gain(before: TrackFit, after: TrackFit) -> float:
    return float(before.solution.chi_square[0] - after.solution.chi_square[0]) / max(after.misfit.noise_variance, 1.0)


def _reason(count: int, misfit: Misfit) -> str:
    what = "a dipole" if count == 1 else f"{count} dipoles"
    return (
        f"the readings are not those of {what} beside a regional field with a constant gradient: what is left is "
        f"{np.sqrt(misfit.colour):.3g} times the noise where it is slow. Take a shorter stretch about one source, "
        "state the noise of the attitude or a larger error of the velocity, or calibrate the array anew"
    )


def _without_source(passage: Passage) -> FloatArray:
    """Return the regional field and gradient that most samples have in the world, and what else is expected."""
    outputs = _outputs(passage, passage.readings_T)
    turn, full = passage.matrix, passage.known.expected.copy()
    tensor = np.median(turn @ tensors_of(outputs) @ np.swapaxes(turn, 1, 2), axis=0)
    uniform = np.median((turn @ outputs[:, :3, None])[..., 0] - passage.path_m @ tensor, axis=0)
    full[UNIFORM], full[GRADIENT] = uniform, tensor[TENSOR_ROWS, TENSOR_COLUMNS]
    free = passage.known.is_free
    unknown: FloatArray = full[free]
    return unknown


def _outputs(passage: Passage, readings_T: FloatArray) -> FloatArray:
    """Return the field and gradient (N, 9) of readings (N, K, 3)."""
    outputs: FloatArray = readings_T.reshape(len(readings_T), -1) @ passage.array.operator.T
    return outputs


def _tested(passage: Passage, solution: Solution) -> TrackFit:
    residuals, slopes = passage.whitened(solution.unknowns[0])
    return TrackFit(solution, misfit_of(residuals, slopes, np.nan_to_num(solution.covariance[0])))


def fit_sources(passage: Passage, count: int) -> Solution:
    """Return the best fit of so many sources.

    Parameters
    ----------
    passage : Passage
        The readings.
    count : int
        Number of sources.

    Raises
    ------
    Refused
        When the readings do not determine the sources.
    """
    solution = _best_fit(passage, count)
    if not solution.is_found[0]:
        raise Refused(_UNDETERMINED)
    return solution


def _best_fit(passage: Passage, count: int) -> Solution:
    """Return the best fit of so many sources, whether it is found or not.

    The noise is taken for larger at first: with noise of a ten-thousandth of the signal, and errors of the attitude of
    a hundred times the noise, χ² is a narrow, bent valley that is followed by small steps only.
    """
    sizes = 10.0 ** np.arange(_decades(passage) if passage.attitude_noise else 0, -1, -1)
    rough = passage.coarse(sizes[0], _COARSE)
    tried = [solve(rough, start, _ROUGH_STEP) for start in _starts(rough, count)]
    solution = min(tried, key=lambda each: float(each.chi_square[0]))
    for size in sizes[1:-1]:
        solution = solve(passage.coarse(size, _COARSE), solution.unknowns[0], _ROUGH_STEP)
    return solve(passage, solution.unknowns[0])


def _decades(passage: Passage) -> int:
    """Return the powers of ten from the noise to a tenth of what is read beside the regional field."""
    left = passage.left_T(_without_source(passage)) / passage.noise_T[:, None]
    size = float(np.sqrt(np.mean(left**2))) / _SIGNAL
    return int(np.ceil(np.log10(max(size, 1.0))))


def _starts(passage: Passage, count: int) -> list[FloatArray]:
    """Return the best starts (P,) of so many sources: places that Euler's equation sees, moments by least squares.

    The moments are found as those of dipoles. One source has one start, two have four: what they make is less alike.
    """
    passage = replace(passage, kernel=dipole_field)
    unknowns = _without_source(passage)
    places = _places(passage, unknowns)
    if len(places) < count:
        raise Refused("the field or its gradient is zero in every pose: there is no source to be seen")
    sources = np.column_stack([places, np.zeros_like(places)]).ravel()
    tried = np.concatenate([sources, unknowns])
    predicted, slopes = passage.predict(tried)
    moments = np.arange(sources.size).reshape(-1, 6)[:, 3:]
    regional = sources.size + np.arange(len(unknowns) - int(passage.known.is_free[VELOCITY].sum()))
    normal, scale = scaled(slopes.T @ slopes)
    slope = slopes.T @ (passage.data - predicted) / scale
    sets = [
        (np.array(chosen), np.concatenate([moments[list(chosen)].ravel(), regional]))
        for chosen in combinations(range(len(places)), count)
    ]
    columns = np.array([each for _, each in sets])
    inverse = np.linalg.pinv(normal[columns[:, :, None], columns[:, None]], hermitian=True)
    change = (inverse @ slope[columns][..., None])[..., 0]
    gain = np.sum(change * slope[columns], axis=1)
    starts = []
    for at in np.argsort(-gain, kind="stable")[: count**2]:
        chosen, own = sets[at]
        start = tried.copy()
        start[own] += change[at] / scale[own]
        starts.append(np.concatenate([start[: sources.size].reshape(-1, 6)[chosen].ravel(), start[sources.size :]]))
    return starts


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
