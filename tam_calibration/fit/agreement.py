"""Whether one part of what a fit is made of agrees with all the rest, and how long what it tells lasts."""

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.normal_equations import Normal
from tam_calibration.core.slow_cosines import BLOCKS, SlowSums
from tam_calibration.fit.contradiction import SIGNIFICANT, probability_of
from tam_calibration.fit.problem import Place, Problem
from tam_calibration.model.units import FloatArray

LEAST_SHARE = 1e-3
"""Part of the information on a direction that both sides have at least where they can contradict."""

SEEN = 1e-12
"""Part of the largest eigenvalue of a scaled information below which a direction is open."""

TOO_FAR = 2.0
"""Stated noise over that of the residuals, or the reverse, from which the stated one is not used: a factor of two in
standard errors."""

FAR = 4.0
"""Standard deviations of a normal law, once in 16 000, from which a difference is reported."""


@dataclass(frozen=True, eq=False)
class MotionFit:
    """A fit with attitude or angular velocity as data, to be judged.

    Parameters
    ----------
    problem : Problem
        The likelihood.
    place : Place
        Where it settled.
    """

    problem: Problem
    place: Place

    @cached_property
    def own(self) -> Normal:
        """What attitude or angular velocity tells."""
        return self.problem.motion_at(self.place)

    @cached_property
    def everything(self) -> Normal:
        """What is known in all."""
        return self.problem.normal_at(self.place)

    @cached_property
    def basis(self) -> FloatArray:
        """(Q, M) directions of the free unknowns."""
        return self.problem.basis_at(self.place)

    @cached_property
    def white(self) -> FloatArray:
        """(Q, M) directions of the free unknowns on which the information of all is one."""
        inside = self.basis.T @ self.everything.information @ self.basis
        return np.asarray(self.basis @ whitening(inside, SEEN))

    @property
    def scatter(self) -> float:
        """Noise that the residuals of attitude or angular velocity show, the channels that the fit took left out."""
        assert self.problem.motion is not None and self.place.motion is not None
        return self.problem.motion.scatter(*self.problem.rows_at(self.place), self.place.motion, self.taken)

    @property
    def taken(self) -> float:
        """Number of channels of attitude or angular velocity that the fit took."""
        return float(np.sum(_shares(self.white, self.own)[0]))

    def difference(self, some: Normal) -> str:
        """Return χ² of the difference that some data make to the estimate, where chance hardly makes as much.

        At the best errors its score is what the others' balances, and has the variance of the parallel sum of both
        informations (Hausman 1978): no fit without it is needed.
        """
        parts, along = _shares(self.white, some)
        compared = (parts > LEAST_SHARE) & (1 - parts > LEAST_SHARE)
        chi_square, freedom = float(np.sum(along[compared] ** 2 / (parts * (1 - parts))[compared])), int(compared.sum())
        if probability_of(chi_square, freedom) >= SIGNIFICANT:
            return ""
        return f"χ² {chi_square:.3g} of {freedom} errors"

    def lasting(self, along: FloatArray | None = None) -> float:
        """Return by how much what the samples tell varies more than by white noise: for how many the errors last.

        Parameters
        ----------
        along : (Q, M) array, optional
            Directions of the unknowns that count; by default all that are free.
        """
        assert self.problem.motion is not None
        count, along = self.problem.motion.sample_count, self.basis if along is None else along
        if count < BLOCKS:
            return 1.0
        spans = [slice(*span) for span in pairwise(np.linspace(0, count, BLOCKS + 1).astype(int))]
        parts = [self.problem.motion_at(self.place, span) for span in spans]
        information = np.array([along.T @ part.information @ along for part in parts])
        white = whitening(information.sum(axis=0), SEEN)
        score = np.array([white.T @ along.T @ part.score for part in parts])
        return SlowSums.of(white.T @ information @ white, score).factor


def _shares(white: FloatArray, some: Normal) -> tuple[FloatArray, FloatArray]:
    """Return the part (M,) that some information is of all on each direction, and its score along them."""
    parts, directions = np.linalg.eigh(white.T @ some.information @ white)
    return np.clip(parts, 0, 1), directions.T @ white.T @ some.score
