"""The last half minute of samples, in which a change of the sensors is looked for.

The samples are kept in blocks, which are weighed against what was known before them. The first alarm
says that there is a change, and when it may have come at the earliest; it may have come within the block that raised
it. What has changed is therefore found from the blocks after that one alone, against what was known before the earliest
moment.

A source that is passed is no change: errors that have changed explain every block after the change.

By how much the means of blocks of samples vary more than white noise of the stated size makes them.

At sea noise lasts that was white at the pier: a motor, waves, the heading error of a scalar. Differences of the means
of two blocks do not contain what is constant, as errors of the sensors are, and of a change or a passing source only
some differences do: their median tells the noise. Of noise that lasts longer, differences over a longer time tell more.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.fit.contradiction import FAR_RATIO
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.prior import Prior
from tam_calibration.live.change import Before, Evidence, Weighing, hypotheses
from tam_calibration.live.recursion import Belief, MomentLikelihood, SampleMoments, Walk
from tam_calibration.model.array import KnownNoiseArray
from tam_calibration.model.data_sheet import DAY_S
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray

_LAGS = (1, 4, 8)
"""Blocks between two that are compared: up to a quarter of a minute."""

_PAIRS = 4
"""Pairs of blocks over the blocks between them, from which they are compared: a change is in a quarter of them."""


@dataclass(frozen=True, eq=False)
class BlockMeans:
    """Means over the samples of a block.

    Parameters
    ----------
    readings_T : (K, 3) array
        Raw readings, tesla.
    intensity_T : float
        Of the mean field of the sensors, tesla.
    beyond_T : float
        That intensity beyond the reading of the scalar, tesla.
    count, scalar_count : int
        Number of samples, and of those with a scalar reading.
    before_T : float
        Intensity of the common field of these readings, by the errors that were known then, tesla.
    """

    readings_T: FloatArray
    intensity_T: float
    beyond_T: float
    count: int
    scalar_count: int
    before_T: float

    @classmethod
    def of(cls, errors: SensorErrors, readings_T: FloatArray, scalar_T: FloatArray) -> "BlockMeans":
        """Return those of samples: readings (n, K, 3) and intensities (n,), NaN where there is none."""
        known = np.isfinite(scalar_T)
        intensity_T = norm(errors.restore(readings_T).mean(axis=1), axis=1)
        beyond_T = float(np.mean((intensity_T - scalar_T)[known])) if known.any() else 0.0
        mean_T = float(intensity_T.mean())
        before_T = float(norm(errors.restore(readings_T.mean(axis=0)[None])[0].mean(axis=0)))
        return cls(readings_T.mean(axis=0), mean_T, beyond_T, len(readings_T), int(known.sum()), before_T)

    def at(self, errors: SensorErrors) -> FloatArray:
        """Return by how much sensors and scalar differ from the common field with other errors, tesla.

        Returns
        -------
        (3 K + 1,) array
            Of the axes of each sensor, and of the intensity.
        """
        fields_T = errors.restore(self.readings_T[None])[0]
        differences_T = np.einsum("kij,kj->ki", errors.matrix, fields_T - fields_T.mean(axis=0))
        return np.append(differences_T, self.beyond_T + norm(fields_T.mean(axis=0)) - self.before_T)


def noise_of(array: KnownNoiseArray) -> FloatArray:
    """Return the noise (3 K + 1,) of ``BlockMeans.at`` for one sample, tesla; the sensors share their mean."""
    count, vector_T2 = len(array.vector_noise_T), float(np.mean(array.vector_noise_T**2))
    return np.sqrt([*[vector_T2] * (3 * count), vector_T2 / count + array.scalar_noise_T**2])


class BlockNoise:
    """Follows the noise of both channels.

    Parameters
    ----------
    array : KnownNoiseArray
        With the noise that is stated.
    """

    def __init__(self, array: KnownNoiseArray) -> None:
        self._noise_T, self._freedom = noise_of(array), 3 * len(array.vector_noise_T) - 3
        # Blocks, two minutes: a change or a source within them spoils less than half of the differences.
        self._blocks: deque[BlockMeans] = deque(maxlen=64)

    def add(self, means: BlockMeans) -> None:
        """Add a block."""
        self._blocks.append(means)

    @property
    def is_known(self) -> bool:
        """Whether it has seen blocks enough for noise that lasts."""
        return len(self._blocks) >= (_PAIRS + 1) * _LAGS[-1]

    def factors(self, errors: SensorErrors) -> VarianceFactors:
        """Return the variance of the means of blocks over that of white noise; 1 where it may be that.

        Parameters
        ----------
        errors : SensorErrors
            As they are known now: what an earlier estimate made of the blocks is no noise.
        """
        values = np.array([means.at(errors) for means in self._blocks]) / self._noise_T
        counts = np.array([(means.count, means.scalar_count) for means in self._blocks])
        known = counts[:, 1] > 0
        return VarianceFactors(
            _factor(values[:, :-1], counts[:, 0], self._freedom), _factor(values[known, -1:], counts[known, 1], 1)
        )


def _factor(values: FloatArray, counts: IntArray, freedom: int) -> float:
    """Return the variance of the means (M, C) of so many samples (M,) over that of white noise.

    What grows with the time between blocks, as the heading error of a scalar does, is the same in all of them: it does
    not become smaller in their mean.
    """
    from scipy.special import chdtri

    found, ratio_of_next = 1.0, 1.0
    for lag in _LAGS if freedom else ():
        pairs = len(values) - lag
        if pairs >= _PAIRS * lag:
            energies = np.sum((values[lag:] - values[:-lag]) ** 2, axis=1) / (1 / counts[lag:] + 1 / counts[:-lag])
            ratio = float(np.median(energies) / chdtri(freedom, 0.5))
            # Standard deviations of the logarithm of a mean of normal squares by which a median may exceed that of
            # white noise.
            by_chance = np.exp(5.0 * np.sqrt(2 / (freedom * pairs)))
            ratio = ratio if ratio > by_chance else 1.0
            ratio_of_next = ratio if lag == 1 else ratio_of_next
            lasting = ratio - ratio_of_next if ratio > by_chance * ratio_of_next else 0.0
            found = max(found, ratio + lasting * (len(values) - 1))
    return found


BLOCK_S = 2.0
"""Time that a block spans, seconds: short compared with the delay of a report, and long enough that solving for
the errors anew with each block costs little."""

WINDOW = 15
"""Blocks within which a change is looked for, half a minute: what comes more slowly is learned as a drift."""

DECIDE_S = 20.0
"""Longest time from a change to its report, seconds: alternatives that remain by then are all named. With
the blocks in which it begins and ends it is reported within half a minute."""

MOST_AFTER = int(DECIDE_S / BLOCK_S)
"""Blocks that are looked at while something passes: once these show nothing it has passed."""


FEWEST_AFTER = 2
"""Blocks after the alarm from which a change, or that it has passed, is reported."""

SCREENED = (1, 2, 4, 8, 14)
"""Numbers of last blocks that are weighed each time; all others only where one of these shows a change. Between two of
them a change has at least half of the blocks that would show it best."""

FALSE_ALARMS_A_DAY = 0.1
"""Bound of their expected number: the chance of each test is this over all tests of a day, as if all were independent.
One in ten days leaves room for noise that is not quite normal."""


def chance_of_test(hypotheses_count: int) -> float:
    """Return the chance that one test of one of so many hypotheses may have of a false alarm."""
    return FALSE_ALARMS_A_DAY * BLOCK_S / DAY_S / WINDOW / hypotheses_count


class Step(NamedTuple):
    """A block of samples.

    Parameters
    ----------
    before : Belief
        What was known before it.
    excess : float
        Variance of the residuals of earlier blocks over that which the noise is stated to have.
    likelihood : MomentLikelihood
        Of its samples.
    means : BlockMeans
        Of its samples.
    here : Linearization
        What the block says, at the errors of ``before``.
    moments : SampleMoments
        Of its samples.
    begin_s : float
        Stamp of its first sample, seconds.
    """

    before: Belief
    excess: float
    likelihood: MomentLikelihood
    means: BlockMeans
    here: Linearization
    moments: SampleMoments
    begin_s: float


class Suspicion(NamedTuple):
    """A change that is more probable than chance.

    Parameters
    ----------
    first : Step
        Before which it had not come.
    after : tuple of Step
        Those that it came before.
    found : tuple of Evidence
        What has changed, the most probable first, and what is not clearly less so; empty where it has passed.
    is_decided : bool
        Whether it is clear, or time to tell it.
    """

    first: Step
    after: tuple[Step, ...]
    found: tuple[Evidence, ...]
    is_decided: bool

    @property
    def since_s(self) -> float:
        """Stamp from which it may have come, seconds."""
        return self.first.begin_s + BLOCK_S


def _passes(evidence: Evidence, first: Step, after: Sequence[Step]) -> bool:
    """Return whether something passes, and no errors have changed.

    Then sensors and scalar do not agree in all blocks as they do in the mean of these blocks, or the intensity of the
    field has changed, from block to block, by more than the sensors differ.
    """
    from scipy.special import chdtri

    vector = (first.before.errors.to_vector().ravel() + evidence.change).reshape(-1, 12)
    errors = SensorErrors.from_vector(vector, first.before.errors.orientation)
    values_T = np.array([step.means.at(errors) for step in after])
    variance_T2 = noise_of(after[0].likelihood.array) ** 2
    weight = np.array([_counts(step, values_T.shape[1]) for step in after]) / variance_T2
    left_T = values_T - np.sum(weight * values_T, axis=0) / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
    freedom = (len(after) - 1) * (3 * errors.sensor_count - 2)
    # Probability of what a change leaves, by chance, below which it is none: of a change of the sensors as it
    # came.
    # Part of what a change explains that it may leave: over large changes lengths are no straight lines.
    if freedom and float(np.sum(weight * left_T**2)) > max(chdtri(freedom, 0.01), 1e-3 * evidence.ratio):
        return True
    seen_T = np.abs(np.mean([step.means.at(first.before.errors) for step in after], axis=0)).max()
    intensity_T = np.array([step.means.intensity_T for step in (first, *after)])
    # Change of the intensity from block to block over what sensors differ by, from which a source passes: on a
    # vehicle of 1 m/s, whose sensors are 0.25 m from their centre, that of a distant source is eight.
    return bool(np.abs(np.diff(intensity_T)).max() > 3.0 * seen_T)


def _counts(step: Step, channels: int) -> FloatArray:
    """Return how many samples of white noise the means of a block count as, for each of its channels."""
    factors = step.likelihood.factors
    each = np.full(channels, step.means.count / factors.differential)
    each[-1] = step.means.scalar_count / factors.common_mode
    return each


class _Sums(NamedTuple):
    """What blocks say together at the errors before them, and the number of their samples."""

    before: Step
    information: FloatArray
    gradient: FloatArray
    samples: int


class ChangeWindow:
    """Looks for changes within the last blocks.

    Parameters
    ----------
    prior : Prior
        Of the sensors.
    walk : Walk
        How they change without being touched.
    """

    def __init__(self, prior: Prior, walk: Walk) -> None:
        self._walk, self._size = walk, prior.covariance.shape[0]
        among = hypotheses(prior.errors, prior.calibration.array)
        self._weighing = Weighing(among, chance_of_test(len(among)))
        self._steps: deque[Step] = deque(maxlen=WINDOW)
        self._first: Step | None = None
        self._after: list[Step] = []

    @property
    def is_full(self) -> bool:
        """Whether it spans half a minute."""
        return len(self._steps) == WINDOW

    def clear(self) -> None:
        """Forget the blocks: the change in them has been reported."""
        self._steps.clear()
        self._first, self._after = None, []

    def add(self, step: Step, end_s: float, temperature_C: float) -> Suspicion | None:
        """Add a block, and return the most probable change; None where there may be none.

        Parameters
        ----------
        step : Step
            The block.
        end_s, temperature_C : float
            At its end.
        """

        def weigh(sums: _Sums) -> tuple[Evidence, ...]:
            before = self._before(sums.before, end_s, temperature_C, sums.samples)
            return self._weighing.weigh(sums.information, sums.gradient, before)

        if self._first is None:
            self._steps.append(step)
            return self._alarm(weigh)
        self._after.append(step)
        found = weigh(self._sums(self._first, self._after)[0])
        if found and found[0].ratio > FAR_RATIO:
            moments = sum((each.moments for each in self._after), SampleMoments.none(step.before.errors.sensor_count))
            before = self._before(self._first, end_s, temperature_C, moments.count)
            linearize = partial(step.likelihood.linearize, moments)
            found = self._weighing.weigh_far(linearize, self._first.before.errors, before) or found
        if found and _passes(found[0], self._first, self._after):
            self._after = self._after[-MOST_AFTER:]
            return Suspicion(self._first, tuple(self._after), (), False)
        is_late = not 0 <= end_s - self._first.begin_s < DECIDE_S
        is_decided = len(self._after) >= FEWEST_AFTER and (len(found) < 2 or is_late)
        return Suspicion(self._first, tuple(self._after), found, is_decided)

    def _before(self, first: Step, end_s: float, temperature_C: float, count: int) -> Before:
        walked = self._walk.covariance(first.before, end_s, temperature_C)
        return Before(first.before.covariance + walked, count, first.excess)

    def _alarm(self, weigh: Callable[[_Sums], tuple[Evidence, ...]]) -> Suspicion | None:
        """Return a suspicion where the last blocks raise an alarm."""
        sums = self._sums(self._steps[0], list(self._steps)[1:])
        if not any(weigh(sums[-blocks]) for blocks in SCREENED if blocks <= len(sums)):
            return None
        found = [(each.before, evidence) for each in sums if (evidence := weigh(each))]
        self._first, evidence = max(found, key=lambda each: each[1][0].score)
        return Suspicion(self._first, (), evidence, False)

    def _sums(self, first: Step, after: list[Step]) -> list[_Sums]:
        """Return what the blocks after a first one say: all of them, all but one, and so on to the last alone."""
        steps, sums = [first, *after], list[_Sums]()
        information, gradient, count = np.zeros((self._size, self._size)), np.zeros(self._size), 0
        for before, step in reversed(list(pairwise(steps))):
            information = information + step.here.both.information
            # Moved from the errors at which the block was linearised to those before all of them.
            moved = (step.before.errors.to_vector() - before.before.errors.to_vector()).ravel()
            gradient = gradient + step.here.both.score + information @ moved
            count += step.moments.count
            sums.append(_Sums(before, information, gradient, count))
        return sums[::-1]
