"""Whether the samples of a run, each located by itself, are those of one source at rest in a uniform field."""

import numpy as np

from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.line_fit import CURRENT_INDEX
from tam_calibration.localization.sample_by_sample import SOURCES
from tam_calibration.localization.solutions import EulerSolutions
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray

_CHANCE = 1e-3
"""Probability with which the noise of one source leaves as much of a run as is refused."""

_FEWEST_LOCATED = 10
"""Samples of a run: of fewer, what is left does not tell a second source that moves them by ten standard errors."""

_SEEN_MOMENT = 3.0
"""Standard errors of a moment that tells by its likeness to others whether they are of one source."""

_IN_COMMON = 3
"""Normal numbers that turn all lines of a run: the errors of the regional field, which are the same in all samples."""

_MEND = (
    "Take a longer stretch about one source, or of dipoles give the velocity of a straight track, along which several "
    "of them and a gradient of the field are found"
)


def require_one_source(solutions: EulerSolutions, index: float = DIPOLE_INDEX) -> None:
    """Refuse the samples of a run that several sources, or a field that is not uniform, have made.

    Of eight outputs a dipole takes six, and a regional field that is uncertain, or an attitude, hides what a second one
    does to the other two. But the moment of a source at rest is the same in all samples, and so is the direction of a
    line.

    Parameters
    ----------
    solutions : EulerSolutions
        Of all samples, along the axes of the world.
    index : float
        Structural index.

    Raises
    ------
    Refused
        When all samples together leave more than noise beside one source and a uniform regional field, known as it is,
        their moments or directions differ by more, or too few are located to tell.
    """
    from scipy.special import chdtrc

    at = solutions.is_located
    left, moments, covariance = (
        each[at] for each in (solutions.chi_square, solutions.moment_Am2, solutions.moment_covariance_A2m4)
    )
    if not len(left):
        return
    is_told = np.sum(moments**2, axis=1) > _SEEN_MOMENT**2 * np.trace(covariance, axis1=1, axis2=2)
    telling = int(is_told.sum()) if index == DIPOLE_INDEX else len(left)
    if telling < _FEWEST_LOCATED:
        raise Refused(
            f"only {telling} samples are located so well that one source is told from several: {_FEWEST_LOCATED} are "
            f"needed. {_MEND}"
        )
    tests = [
        (float(left.sum()), len(left) * (3 if index == CURRENT_INDEX else 2), "what is left is {:.3g} times the noise")
    ]
    words = "their {} differ by {{:.3g}} of their standard errors"
    if index == DIPOLE_INDEX:
        tests.append((_chi_square_of_equal(moments, covariance), moments[1:].size, words.format("moments")))
    else:
        turns, covariance = _turns_of(solutions.along[at], solutions.along_covariance[at])
        size = _chi_square_of_equal(turns, covariance) / turns[1:].size
        tests.append((_IN_COMMON * size, _IN_COMMON, words.format("directions")))
    for total, freedom, words in tests:
        if chdtrc(freedom, total) < _CHANCE:
            raise Refused(
                f"the samples are not those of one {SOURCES[index]} at rest beside a uniform regional field: "
                f"{words.format(np.sqrt(total / freedom))}. {_MEND}"
            )


def _chi_square_of_equal(vectors: FloatArray, covariance: FloatArray) -> float:
    """Return χ² of vectors (n, D) with covariances (n, D, D) about their weighted mean."""
    weight = np.linalg.inv(covariance)
    mean = np.linalg.solve(weight.sum(axis=0), np.einsum("nij,nj->i", weight, vectors))
    off = vectors - mean
    return float(np.einsum("ni,nij,nj->", off, weight, off))


def _turns_of(along: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return by what unit vectors (n, 3), either way, are turned out of their mean (n, 2), and the covariances."""
    _, vectors = np.linalg.eigh(along.T @ along)
    across, mean = vectors[:, :2], vectors[:, 2]
    turns = np.sign(along @ mean)[:, None] * along @ across
    return turns, across.T @ covariance @ across
