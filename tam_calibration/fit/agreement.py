"""Whether one part of what a fit is made of agrees with all the rest, and how long what it tells lasts."""

from collections.abc import Callable
from itertools import pairwise
from typing import Protocol

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.slow_cosines import BLOCKS
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.slow_sums import SlowSums
from tam_calibration.model.units import FloatArray

LEAST_TOLD = 1e-3
"""Part of the information on a direction that both sides have at least where they can contradict."""

SEEN = 1e-12
"""Part of the largest eigenvalue of a scaled information below which a direction is open."""


class Equations(Protocol):
    """Information (Q, Q) and downhill gradient (Q,) over the unknowns of a problem."""

    @property
    def information(self) -> FloatArray:
        """(Q, Q) array."""

    @property
    def gradient(self) -> FloatArray:
        """(Q,) array."""


def white_directions(information: FloatArray, basis: FloatArray) -> FloatArray:
    """Return directions (Q, M), of those that a basis spans, on which an information (Q, Q) is one."""
    return np.asarray(basis @ whitening(basis.T @ information @ basis, SEEN))


def shares(white: FloatArray, information: FloatArray, gradient: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the part (M,) that some information is of all on each direction, and its gradient along them."""
    parts, directions = np.linalg.eigh(white.T @ information @ white)
    return np.clip(parts, 0, 1), directions.T @ white.T @ gradient


def difference(white: FloatArray, information: FloatArray, gradient: FloatArray) -> str:
    """Return χ² of the difference that some information makes to the estimate, where chance hardly makes as much.

    At the best errors its score is what the others' balances, and has the variance of the parallel sum of both
    informations (Hausman 1978): no fit without it is needed.
    """
    parts, score = shares(white, information, gradient)
    told = (parts > LEAST_TOLD) & (1 - parts > LEAST_TOLD)
    chi_square, freedom = float(np.sum(score[told] ** 2 / (parts * (1 - parts))[told])), int(told.sum())
    if probability_of(chi_square, freedom) >= SIGNIFICANT:
        return ""
    return f"χ² {chi_square:.3g} of {freedom} errors"


def lasting(equations_of: Callable[[slice], Equations], count: int, along: FloatArray) -> float:
    """Return by how much what samples tell varies more than by white noise: for how many samples its errors last.

    Parameters
    ----------
    equations_of : callable
        From some of the samples to what they tell.
    count : int
        Number of samples.
    along : (Q, M) array
        Directions of the unknowns that count.
    """
    if count < BLOCKS:
        return 1.0
    spans = [slice(*span) for span in pairwise(np.linspace(0, count, BLOCKS + 1).astype(int))]
    parts = [equations_of(span) for span in spans]
    information = np.array([along.T @ part.information @ along for part in parts])
    white = whitening(information.sum(axis=0), SEEN)
    return SlowSums.of(
        white.T @ information @ white, np.array([white.T @ along.T @ part.gradient for part in parts])
    ).factor
