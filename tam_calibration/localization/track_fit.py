"""As many dipoles as the readings of a passage show, or why they show none that can be told.

A fit begins where Euler's equation sees dipoles, round the path, or by splitting one.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution, scaled
from tam_calibration.localization.euler import locate
from tam_calibration.localization.misfit import CHANCE, Misfit, misfit_of
from tam_calibration.localization.passage import ERRORS, GRADIENT, OF_SOURCE, UNIFORM, VELOCITY, Passage, solve
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
        What is free of u, G, δv and z.
    """
    outputs = _outputs(passage, passage.readings_T)
    turn, full = passage.matrix, passage.known.expected.copy()
    tensor = np.median(turn @ tensors_of(outputs) @ np.swapaxes(turn, 1, 2), axis=0)
    uniform = np.median((turn @ outputs[:, :3, None])[..., 0] - passage.path_m @ tensor, axis=0)
    full[UNIFORM], full[GRADIENT] = uniform, tensor[TENSOR_ROWS, TENSOR_COLUMNS]
    free = passage.known.is_free
    return np.asarray(full[free])


def starts(passage: Passage, unknowns: FloatArray, count: int) -> list[FloatArray]:
    """Return the best starts (P,) of so many sources: places that Euler's equation sees, moments by least squares.

    The moments are found as those of dipoles. One source has one start, two have four: what they make is less alike.


    Parameters
    ----------
    passage : Passage
        What was read, and of which sources.
    unknowns : (P,) array
        What is free of u, G, δv and z, without any source.
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
    is_velocity = np.isin(np.flatnonzero(passage.known.is_free), np.arange(VELOCITY.start, VELOCITY.stop))
    beside = len(tried) - len(unknowns) + np.flatnonzero(~is_velocity)
    sets = [np.array(chosen) for chosen in combinations(range(len(places)), count)]
    columns = np.array([np.concatenate([moments[chosen].ravel(), beside]) for chosen in sets])
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
        Places and moments of the sources so far, and what is free of u, G, δv and z.
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
    return np.asarray(passage.path_m[chosen] + offsets)


def _outputs(passage: Passage, readings_T: FloatArray) -> FloatArray:
    """Return the field and gradient (N, 9) of readings (N, K, 3)."""
    return readings_T.reshape(len(readings_T), -1) @ passage.array.operator.T


MOST_SOURCES = 3
"""Dipoles that are looked for: a fourth has not been needed for a single pass."""

_COARSE, _ROUGH_STEP = 200, 1e-3
"""Samples at which a fit begins, and the part of a place and a moment below which its steps end then."""

_LEAST_FALL, _HOPELESS = 1e-3, 2.0
"""Part of χ² by which steps go on with fewer sources, and the χ² over that of noise, or of all sources, with which no
further step helps. They save time: between a tenth and ten times the one, and 1.5 and 10 of the other, what is found
is the same."""

_MOST_ROUNDS = 6
"""Fits in a row of what nearly explains the readings: the valley between two dipoles that are alike is long."""

_SIGNAL = 10.0
"""What is read of sources over the noise with which a fit begins."""

_LEAST_GAIN = 60.0
"""Fall of χ² that a further dipole must bring: of six unknowns by noise alone once in 10¹¹, many places tried."""

LARGEST_COLOUR = 4.0
"""Of residuals by which standard errors are still widened; beyond, what is left out moves the source."""

_MOST_OFF = 4.0
"""Standard errors by which what is known may be found elsewhere: by noise alone once in 5000 passes."""

_LEAST_FOUND = 0.01
"""Part of the variance of a calibration's error by which it must have fallen to be judged."""

_ROUNDING = 1e-6
"""Part of a variance that is known below which its fall is not told from rounding."""

_UNDETERMINED = "the readings do not determine the source: it is too far, too weak, or always seen from the same side"


@dataclass(frozen=True, eq=False)
class TrackFit:
    """Dipoles that were fitted to a passage.

    Parameters
    ----------
    passage : Passage
        What was fitted, with the noise that its readings have.
    solution : Solution
        Of one problem.
    misfit : Misfit
        What it leaves.
    """

    passage: Passage
    solution: Solution
    misfit: Misfit

    @property
    def sources(self) -> FloatArray:
        """(S, 6) places and moments."""
        return self.passage.sources(self.solution.unknowns[0])

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
    best = last = _with_own_noise(_tested(passage, best_fit(passage, 1)))
    passage = best.passage
    nothing = solve(passage, without_source(passage), least_fall=_LEAST_FALL)
    if float(nothing.chi_square[0]) - float(best.solution.chi_square[0]) < _LEAST_GAIN * best.misfit.variance_factor:
        raise Refused("no dipole is seen: noise beside the regional field explains the readings as well")
    while last.misfit.colour > 1 and len(last.sources) < MOST_SOURCES:
        try:
            more = _tested(passage, best_fit(passage, len(last.sources) + 1, last.solution.unknowns[0]))
        except Refused:
            break
        if _gain(last.solution, more) < _LEAST_GAIN:
            break
        last = more = _without_needless(more)
        if more.is_found or not best.is_found:  # one dipole need not settle where there are two
            best = more
    best = _with_own_noise(best)
    if best.misfit.colour > LARGEST_COLOUR:
        raise Refused(_reason(best))
    if not best.is_found:
        raise Refused(_UNDETERMINED)
    _require_expected(best)
    return _strongest_first(best)


def _with_own_noise(fit: TrackFit) -> TrackFit:
    """Return a fit with the noise that its readings have, where that is smaller than the stated one.

    It is what no error of an attitude can make of the faster half of the residuals' cosines.
    """
    from scipy.fft import dct
    from scipy.special import chdtr

    passage, unknowns = fit.passage, fit.solution.unknowns[0]
    fast = dct(passage.unturned(unknowns), axis=0, norm="ortho")[len(passage.matrix) // 2 :]
    freedom = len(fast) * (fast.shape[1] - (3 if passage.attitude_noise else 0))
    energy = float(np.sum(fast**2))
    if freedom < 1 or chdtr(freedom, energy) > CHANCE:
        return fit
    quiet = replace(passage, noise_T=passage.noise_T * np.sqrt(energy / freedom))
    return _tested(quiet, _settled(quiet, unknowns))


def _require_expected(fit: TrackFit) -> None:
    """Refuse what the readings find elsewhere than it was known to be.

    What is found differs from what was expected by as much as the variance has fallen.
    """
    known, solution = fit.passage.known, fit.solution
    free = np.flatnonzero(known.is_free)
    spread = np.zeros((len(known.expected), len(known.expected)))
    spread[np.ix_(free, free)] = solution.covariance[0][-len(free) :, -len(free) :] if len(free) else 0.0
    off = fit.passage.further(solution.unknowns[0]) - known.expected
    _require_calibration(off[ERRORS], spread[ERRORS, ERRORS], fit.misfit.variance_factor)
    at = np.flatnonzero(known.is_uncertain[: ERRORS.start])
    stated = known.standard_error[at]
    fallen = np.sqrt(np.maximum(stated**2 - np.diag(spread)[at], _ROUNDING * stated**2))
    if not (np.abs(off[at]) > _MOST_OFF * fallen).any():
        return
    ratio = np.abs(off[at]) / fallen
    worst = int(at[np.argmax(ratio)])
    what, given = ("velocity", "the velocity") if worst >= VELOCITY.start else ("regional field", "the field's place")
    raise Refused(
        f"the {what} is found {ratio.max():.3g} standard errors from what is stated: check {given}, or state "
        "a larger error of it"
    )


def _require_calibration(errors: FloatArray, spread: FloatArray, factor: float) -> None:
    """Refuse errors (Q,) of the calibration, found with a covariance, that are larger than it says."""
    from scipy.special import chdtrc

    values, vectors = np.linalg.eigh(np.eye(len(errors)) - spread)
    found = values > _LEAST_FOUND
    size = float(np.sum((vectors[:, found].T @ errors) ** 2 / values[found])) / factor
    if found.any() and chdtrc(found.sum(), size) < CHANCE:
        raise Refused(
            f"the sensors' errors are found {np.sqrt(size / found.sum()):.3g} times as far from the calibration as its "
            f"standard errors allow. {_AGAIN}"
        )


def _gain(before: Solution, after: TrackFit) -> float:
    return float(before.chi_square[0] - after.solution.chi_square[0]) / max(after.misfit.noise_variance, 1.0)


def _without_needless(fit: TrackFit) -> TrackFit:
    """Return a fit without sources that are not needed beside the others.

    A single dipole that settled in the wrong place asks for a second, which is then the right one by itself.
    """
    unknowns = fit.solution.unknowns[0]
    for number in range(len(fit.sources) if len(fit.sources) > 1 else 0):
        others = np.delete(unknowns, slice(OF_SOURCE * number, OF_SOURCE * (number + 1)))
        fewer = solve(fit.passage, others, least_fall=_LEAST_FALL)
        if fewer.chi_square[0] > _HOPELESS * fit.solution.chi_square[0]:
            continue
        fewer = solve(fit.passage, fewer.unknowns[0])
        if fewer.is_found[0] and _gain(fewer, fit) < _LEAST_GAIN:
            return _without_needless(_tested(fit.passage, fewer))
    return fit


def _strongest_first(fit: TrackFit) -> TrackFit:
    """Return a fit whose sources are in the order of the field that they make along the path."""
    solution, sources = fit.solution, fit.sources
    center = fit.passage.center_m(solution.unknowns[0])
    field = [norm(dipole_field(center - source[:3], source[3:])[0]) for source in sources]
    order = np.argsort(field)[::-1]
    rest = np.arange(sources.size, solution.unknowns.shape[1])
    at = np.concatenate([np.arange(sources.size).reshape(-1, OF_SOURCE)[order].ravel(), rest])
    own = replace(solution, unknowns=solution.unknowns[:, at], covariance=solution.covariance[:, at[:, None], at])
    return replace(fit, solution=own)


_AGAIN = (
    "Calibrate the array anew; where sensor 1 may be mounted askew, with --method integrated, which takes the axes of "
    "the array from recorded attitude"
)


def _reason(fit: TrackFit) -> str:
    count = len(fit.sources)
    what = "a dipole" if count == 1 else f"{count} dipoles"
    return (
        f"the readings are not those of {what} beside a regional field with a constant gradient: what is left is "
        f"{np.sqrt(fit.misfit.colour):.3g} times the noise where it is slow. Take a shorter stretch about one source, "
        f"or state the noise of the attitude or a larger error of the velocity. {_AGAIN}"
    )


def _tested(passage: Passage, solution: Solution) -> TrackFit:
    residuals, slopes = passage.whitened(solution.unknowns[0])
    return TrackFit(passage, solution, misfit_of(residuals, slopes, np.nan_to_num(solution.covariance[0])))


def best_fit(passage: Passage, count: int, before: FloatArray | None = None) -> Solution:
    """Return the best fit of so many sources, whether it is found or not.

    It begins at places that Euler's equation sees in the readings, and where one source less was fitted ``before``
    also beside that, and if that does not settle or leaves more than noise, with each of its sources split in two.

    Parameters
    ----------
    passage : Passage
        The readings.
    count : int
        Number of sources.
    before : (P,) array, optional
        Unknowns of the fit of one source less.
    """
    nothing = without_source(passage)
    fits = [_annealed(passage, nothing, partial(starts, count=count))]
    if before is not None:
        fits.append(_annealed(passage, before, starts_beside))
        best = _tested(passage, _lowest(fits))
        if not best.is_found or best.misfit.colour > 1:
            fits.append(_annealed(passage, before, starts_split))
    return _lowest(fits)


def _lowest(fits: list[Solution]) -> Solution:
    return min(fits, key=lambda each: float(each.chi_square[0]))


def _annealed(
    passage: Passage, begun: FloatArray, starts_of: Callable[[Passage, FloatArray], list[FloatArray]]
) -> Solution:
    """Return the best of the fits that begin with some unknowns and what is missing beside them.

    The noise is taken for larger at first: with noise of a ten-thousandth of the signal, and errors of the attitude of
    a hundred times the noise, χ² is a narrow, bent valley that is followed by small steps only.
    """
    sizes = 10.0 ** np.arange(_decades(passage, begun) if passage.attitude_noise else 0, -1, -1)
    rough = passage.coarse(sizes[0], _COARSE)
    tried = [solve(rough, start, _ROUGH_STEP) for start in starts_of(rough, begun)]
    solution = _lowest(tried)
    for size in sizes[1:-1]:
        solution = solve(passage.coarse(size, _COARSE), solution.unknowns[0], _ROUGH_STEP)
    return _settled(passage, solution.unknowns[0])


def _settled(passage: Passage, unknowns: FloatArray) -> Solution:
    """Return the fit that begins with some unknowns, where it nearly explains the readings after several rounds."""
    for _ in range(_MOST_ROUNDS):
        solution = solve(passage, unknowns)
        unknowns = solution.unknowns[0]
        if solution.is_found[0] or solution.chi_square[0] > _HOPELESS * len(passage.data):
            break
    return solution


def _decades(passage: Passage, unknowns: FloatArray) -> int:
    """Return the powers of ten from the noise to a tenth of what is read beside unknowns."""
    left = passage.whitened(unknowns)[0]
    size = float(np.sqrt(np.mean(left**2))) / _SIGNAL
    return int(np.ceil(np.log10(max(size, 1.0))))
