"""A calibration that goes on with every block of samples, in bounded memory, and forgets as its sensors change.

Since a stretch began the samples are kept as moments, from which prior and samples are solved anew with every block:
without any change of the sensors that is the fit of prior and all samples, to the last. Sensors change as random walks.
When what the walk may have moved is no longer small compared with the uncertainty, a new stretch begins: its prior is
the estimate, less certain by the walk, as in Kalman's filter.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.linalg import inv

from tam_calibration.core.least_squares import iterate, scaled
from tam_calibration.core.normal_equations import Normal
from tam_calibration.correction.acceptance import are_possible
from tam_calibration.fit.prior import Prior
from tam_calibration.live.moments import MomentLikelihood, SampleMoments
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

LARGEST_WALK = 0.1
"""Sum, over all directions, of the walk's variance over that of the estimate at which a stretch ends: within a stretch
the estimate is that of constant errors, and no variance is too small by more than this part."""

_MOST_STEPS = 20
_SETTLED = 1e-8
"""Twice the fall of the energy that a last step promises: a ten thousandth of a standard error."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Normal distribution of the errors of the sensors at a moment.

    Parameters
    ----------
    errors : SensorErrors
        Mean.
    covariance : (12 K, 12 K) array
        Of the flattened errors, SI; zero for what is held.
    time_s : float
        Stamp of the moment, seconds.
    temperature_C : float
        Of the sensors; NaN where it is unknown.
    """

    errors: SensorErrors
    covariance: FloatArray
    time_s: float
    temperature_C: float

    @cached_property
    def free(self) -> np.ndarray:
        """(12 K,) which of the errors are not held."""
        return np.asarray(np.diag(self.covariance) > 0)

    def dated(self, time_s: float, temperature_C: float) -> "Belief":
        """Return the belief with a time and a temperature where it has none."""
        return replace(
            self,
            time_s=self.time_s if np.isfinite(self.time_s) else time_s,
            temperature_C=self.temperature_C if np.isfinite(self.temperature_C) else temperature_C,
        )

    def joined_with(self, further: Normal, errors: SensorErrors) -> "Belief":
        """Return the belief with further information, at given errors."""
        free, mean = self.free, self.errors.to_vector().ravel()
        downhill = further.score + further.information @ (errors.to_vector().ravel() - mean)
        covariance = np.zeros_like(self.covariance)
        covariance[np.ix_(free, free)] = inverted(self.certainty + further.information[np.ix_(free, free)])
        vector = (mean + covariance @ downhill).reshape(-1, 12)
        return replace(self, errors=SensorErrors.from_vector(vector, self.errors.orientation), covariance=covariance)

    def distance(self, other: SensorErrors) -> float:
        """Return how far other errors are, in standard errors: root mean square over all directions."""
        free = self.free
        step = (other.to_vector() - self.errors.to_vector()).ravel()[free]
        return float(np.sqrt(step @ self.certainty @ step / free.sum()))

    def change_to(self, other: "Belief") -> float:
        """Return by what part of these standard errors another belief has other errors, or other standard errors.

        Each is a root mean square over all directions.
        """
        return max(self.distance(other.errors), abs(self.spread_of(other) - 1))

    def spread_of(self, other: "Belief") -> float:
        """Return the standard errors of another belief over these, in root mean square over all directions."""
        free = self.free
        return float(np.sqrt(np.sum(self.certainty * other.covariance[np.ix_(free, free)]) / free.sum()))

    @cached_property
    def certainty(self) -> FloatArray:
        """(M, M) inverse of the covariance of those errors that are not held."""
        return inverted(self.covariance[np.ix_(self.free, self.free)])


@dataclass(frozen=True, eq=False)
class Walk:
    """How the errors of the sensors change with time and temperature.

    Parameters
    ----------
    prior : Prior
        With the rates, and the convention that what changes must keep.
    """

    prior: Prior

    def covariance(self, before: Belief, time_s: float, temperature_C: float) -> FloatArray:
        """Return the (12 K, 12 K) covariance of the changes since a belief; where time goes back there are none."""
        warming_K = temperature_C - before.temperature_C
        assert self.prior.rates is not None
        variances = self.prior.rates.variances(
            max(time_s - before.time_s, 0.0), warming_K if np.isfinite(warming_K) else 0.0
        )
        derivative = self._derivative
        return derivative * np.tile(variances, before.errors.sensor_count) @ derivative.T

    def kept(self, changes: FloatArray) -> FloatArray:
        """Return changes (12 K, M) of the errors in the convention of the prior: none of what it holds."""
        return self._derivative @ changes

    @cached_property
    def _derivative(self) -> FloatArray:
        """(12 K, 12 K) changes in the convention by changes of the sensors; zero for what the prior holds."""
        _, derivative = self.prior.in_convention(self.prior.errors)
        derivative[np.diag(self.prior.covariance) <= 0] = 0
        return derivative


@dataclass(frozen=True, eq=False)
class Recursion:
    """Where the recursion is.

    Parameters
    ----------
    begin : Belief
        At the beginning of the stretch.
    moments : SampleMoments
        Of its samples.
    now : Belief
        What both say.
    """

    begin: Belief
    moments: SampleMoments
    now: Belief

    @classmethod
    def at(cls, belief: Belief) -> "Recursion":
        """Return the recursion that begins with a belief."""
        return cls(belief, SampleMoments.none(belief.errors.sensor_count), belief)

    def dated(self, time_s: float, temperature_C: float) -> "Recursion":
        """Return the recursion with a time and a temperature where it has none."""
        return replace(self, begin=self.begin.dated(time_s, temperature_C), now=self.now.dated(time_s, temperature_C))

    def joined_with(self, further: Normal, errors: SensorErrors, likelihood: MomentLikelihood) -> "Recursion":
        """Return the recursion with further information on the errors of its stretch, at given errors.

        Raises
        ------
        Refused
            When the iteration does not settle.
        """
        begin, now = self.begin.joined_with(further, errors), self.now
        found = solve(begin, self.moments, now.time_s, now.temperature_C, likelihood, now.errors)
        return replace(self, begin=begin, now=found)

    def after(
        self, moments: SampleMoments, time_s: float, temperature_C: float, likelihood: MomentLikelihood, walk: Walk
    ) -> "Recursion":
        """Return the recursion after another block of samples.

        Parameters
        ----------
        moments : SampleMoments
            Of the block.
        time_s, temperature_C : float
            At its end; a temperature that is NaN is the last one that was known.
        likelihood : MomentLikelihood
            That the moments are of.
        walk : Walk
            By which the sensors change.

        Raises
        ------
        Refused
            When the iteration does not settle.
        """
        if not np.isfinite(temperature_C):
            temperature_C = self.now.temperature_C
        begin, since = self.begin, self.moments
        change = walk.covariance(begin, time_s, temperature_C)
        free = begin.free
        if np.sum(self.now.certainty * change[np.ix_(free, free)]) > LARGEST_WALK:
            begin = Belief(self.now.errors, self.now.covariance + change, time_s, temperature_C)
            since = SampleMoments.none(begin.errors.sensor_count)
        since = since + moments
        now = solve(begin, since, time_s, temperature_C, likelihood, self.now.errors)
        return replace(self, begin=begin, moments=since, now=now)


def solve(
    begin: Belief,
    moments: SampleMoments,
    time_s: float,
    temperature_C: float,
    likelihood: MomentLikelihood,
    start: SensorErrors,
) -> Belief:
    """Return what a belief and samples say together: the maximum of their joint probability, and its covariance.

    Parameters
    ----------
    begin : Belief
        Before the samples.
    moments : SampleMoments
        Of the samples.
    time_s, temperature_C : float
        Of the result.
    likelihood : MomentLikelihood
        That the moments are of.
    start : SensorErrors
        Where to begin.

    Raises
    ------
    Refused
        When the iteration does not settle, or leads to sensors that cannot be.
    """
    free, mean = begin.free, begin.errors.to_vector().ravel()
    orientation = begin.errors.orientation
    certainty = begin.certainty

    def step_from(state: tuple[FloatArray, FloatArray]) -> tuple[tuple[FloatArray, FloatArray], bool]:
        vector, _ = state
        here = likelihood.linearize(moments, SensorErrors.from_vector(vector, orientation)).both
        covariance = inverted(here.information[np.ix_(free, free)] + certainty)
        gradient = here.score[free] - certainty @ (vector - mean)[free]
        step = covariance @ gradient
        moved = vector.copy()
        moved[free] += step
        if not are_possible(moved.reshape(-1, 12)):
            raise Refused("the update leads to sensors that cannot be: the readings do not fit the calibration")
        return (moved, covariance), float(step @ gradient) < _SETTLED

    begin_with: tuple[FloatArray, FloatArray] = (start.to_vector().ravel(), certainty)
    (vector, inside), is_settled = iterate(step_from, begin_with, _MOST_STEPS)
    if not is_settled:
        raise Refused(f"the update did not settle in {_MOST_STEPS} steps: the readings do not fit the calibration")
    covariance = np.zeros_like(begin.covariance)
    covariance[np.ix_(free, free)] = inside
    return Belief(SensorErrors.from_vector(vector, orientation), covariance, time_s, temperature_C)


def inverted(matrix: FloatArray) -> FloatArray:
    """Return the inverse of a positive matrix (M, M) whose rows may be in units of their own."""
    unit, scale = scaled(matrix)
    inverse: FloatArray = inv(unit) / np.outer(scale, scale)
    return (inverse + inverse.T) / 2
