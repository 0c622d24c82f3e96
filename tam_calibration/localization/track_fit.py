"""As many dipoles as the readings of a passage show, or why they show none that can be told."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.least_squares import Solution
from tam_calibration.localization.misfit import Misfit, misfit_of
from tam_calibration.localization.passage import OF_SOURCE, VELOCITY, Passage, solve
from tam_calibration.localization.track_starts import starts, starts_beside, starts_split, without_source
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.dipole import dipole_field

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

_ROUNDING = 1e-6
"""Part of a variance that is known below which its fall is not told from rounding."""

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
    nothing = solve(passage, without_source(passage), least_fall=_LEAST_FALL)
    if float(nothing.chi_square[0]) - float(best.solution.chi_square[0]) < _LEAST_GAIN * best.misfit.variance_factor:
        raise Refused("no dipole is seen: noise beside the regional field explains the readings as well")
    while last.misfit.colour > 1 and _count(passage, last) < MOST_SOURCES:
        try:
            more = _tested(passage, _best_fit(passage, _count(passage, last) + 1, last.solution.unknowns[0]))
        except Refused:
            break
        if _gain(last.solution, more) < _LEAST_GAIN:
            break
        last = more = _without_needless(passage, more)
        if more.is_found or not best.is_found:  # one dipole need not settle where there are two
            best = more
    if not best.is_found:
        raise Refused(_UNDETERMINED)
    if best.misfit.colour > LARGEST_COLOUR:
        raise Refused(_reason(_count(passage, best), best.misfit))
    _require_expected(passage, best.solution)
    return _strongest_first(passage, best)


def _require_expected(passage: Passage, solution: Solution) -> None:
    """Refuse what the readings find elsewhere than it was known to be.

    What is found differs from what was expected by as much as the variance has fallen.
    """
    known = passage.known
    free = np.flatnonzero(known.is_free)
    variance = np.zeros(len(known.expected))
    variance[free] = np.diag(solution.covariance[0])[-len(free) :] if len(free) else 0.0
    at = known.is_uncertain
    off = np.abs(passage.further(solution.unknowns[0]) - known.expected)[at]
    stated = known.standard_error[at]
    fallen = np.sqrt(np.maximum(stated**2 - variance[at], _ROUNDING * stated**2))
    if not (off > _MOST_OFF * fallen).any():
        return
    worst = int(np.flatnonzero(at)[np.argmax(off / fallen)])
    what, given = ("velocity", "the velocity") if worst >= VELOCITY.start else ("regional field", "the field's place")
    raise Refused(
        f"the {what} is found {np.max(off / fallen):.3g} standard errors from what is stated: check {given}, or state "
        "a larger error of it"
    )


def _count(passage: Passage, fit: TrackFit) -> int:
    return len(passage.sources(fit.solution.unknowns[0]))


def _gain(before: Solution, after: TrackFit) -> float:
    return float(before.chi_square[0] - after.solution.chi_square[0]) / max(after.misfit.noise_variance, 1.0)


def _without_needless(passage: Passage, fit: TrackFit) -> TrackFit:
    """Return a fit without sources that are not needed beside the others.

    A single dipole that settled in the wrong place asks for a second, which is then the right one by itself.
    """
    unknowns = fit.solution.unknowns[0]
    for number in range(_count(passage, fit) if _count(passage, fit) > 1 else 0):
        others = np.delete(unknowns, slice(OF_SOURCE * number, OF_SOURCE * (number + 1)))
        fewer = solve(passage, others, least_fall=_LEAST_FALL)
        if fewer.chi_square[0] > _HOPELESS * fit.solution.chi_square[0]:
            continue
        fewer = solve(passage, fewer.unknowns[0])
        if fewer.is_found[0] and _gain(fewer, fit) < _LEAST_GAIN:
            return _without_needless(passage, _tested(passage, fewer))
    return fit


def _strongest_first(passage: Passage, fit: TrackFit) -> TrackFit:
    """Return a fit whose sources are in the order of the field that they make along the path."""
    solution = fit.solution
    sources = passage.sources(solution.unknowns[0])
    center = passage.center_m(solution.unknowns[0])
    field = [norm(dipole_field(center - source[:3], source[3:])[0]) for source in sources]
    order = np.argsort(field)[::-1]
    rest = np.arange(sources.size, solution.unknowns.shape[1])
    at = np.concatenate([np.arange(sources.size).reshape(-1, OF_SOURCE)[order].ravel(), rest])
    own = replace(solution, unknowns=solution.unknowns[:, at], covariance=solution.covariance[:, at[:, None], at])
    return replace(fit, solution=own)


def _reason(count: int, misfit: Misfit) -> str:
    what = "a dipole" if count == 1 else f"{count} dipoles"
    return (
        f"the readings are not those of {what} beside a regional field with a constant gradient: what is left is "
        f"{np.sqrt(misfit.colour):.3g} times the noise where it is slow. Take a shorter stretch about one source, "
        "state the noise of the attitude or a larger error of the velocity, or calibrate the array anew"
    )


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


def _best_fit(passage: Passage, count: int, before: FloatArray | None = None) -> Solution:
    """Return the best fit of so many sources, whether it is found or not.

    It begins at places that Euler's equation sees in the readings, and where one source less was fitted ``before``
    also beside that, and if that does not settle or leaves more than noise, with each of its sources split in two.
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
    for _ in range(_MOST_ROUNDS):
        solution = solve(passage, solution.unknowns[0])
        if solution.is_found[0] or solution.chi_square[0] > _HOPELESS * len(passage.data):
            break
    return solution


def _decades(passage: Passage, unknowns: FloatArray) -> int:
    """Return the powers of ten from the noise to a tenth of what is read beside unknowns."""
    left = passage.whitened(unknowns)[0]
    size = float(np.sqrt(np.mean(left**2))) / _SIGNAL
    return int(np.ceil(np.log10(max(size, 1.0))))
