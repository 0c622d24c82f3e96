"""The last half minute of samples in blocks, and whether the sensors have changed within it.

The last blocks are weighed against what was known before them. The first alarm says that there is a change, and when it
may have come at the earliest; it may have come within the block that raised it. What has changed is therefore told by
the blocks after that one alone, against what was known before the earliest moment.
"""

from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.sensor_changes import FAR_RATIO
from tam_calibration.live.change import Evidence, Weighing, hypotheses
from tam_calibration.live.recursion import Belief, Walk
from tam_calibration.live.sample_moments import MomentLikelihood, SampleMoments
from tam_calibration.model.change_rates import DAY_S
from tam_calibration.model.units import FloatArray

BLOCK_S = 2.0
"""Time that a block spans, seconds: short beside what may pass until a change is told, and long enough that solving for
the errors anew with each block costs little."""

WINDOW = 15
"""Blocks within which a change is looked for, half a minute: what comes more slowly is learned as a drift."""

DECIDE_S = 20.0
"""Time from a change to when it is told in any case, seconds: what cannot be told apart by then is told as such. With
the blocks in which it begins and ends it is told within half a minute."""

FEWEST_AFTER = 2
"""Blocks after the alarm from which a change is told, or is told to have passed."""

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
    here : Linearization
        What the block says, at the errors of ``before``.
    moments : SampleMoments
        Of its samples.
    begin_s : float
        Stamp of its first sample, seconds.
    """

    before: Belief
    excess: float
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
    likelihood : MomentLikelihood
        That the moments of the blocks are of.
    """

    def __init__(self, prior: Prior, walk: Walk, likelihood: MomentLikelihood) -> None:
        self._walk, self._likelihood, self._size = walk, likelihood, prior.covariance.shape[0]
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
        """Forget the blocks: what they say of changes has been told."""
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
            before = sums.before.before
            covariance = before.covariance + self._walk.covariance(before, end_s, temperature_C)
            excess = sums.before.excess
            return self._weighing.weigh(sums.information, sums.gradient, covariance, sums.samples, excess)

        if self._first is None:
            self._steps.append(step)
            return self._alarm(weigh)
        self._after.append(step)
        found = weigh(self._sums(self._first, self._after)[0])
        if found and found[0].ratio > FAR_RATIO:
            found = self._weigh_far(self._first, self._after, end_s, temperature_C) or found
        is_late = not 0 <= end_s - self._first.begin_s < DECIDE_S
        is_decided = len(self._after) >= FEWEST_AFTER and (len(found) < 2 or is_late)
        return Suspicion(self._first, tuple(self._after), found, is_decided)

    def _weigh_far(self, first: Step, after: list[Step], end_s: float, temperature_C: float) -> tuple[Evidence, ...]:
        before = first.before
        covariance = before.covariance + self._walk.covariance(before, end_s, temperature_C)
        moments = sum((step.moments for step in after), SampleMoments.none(before.errors.sensor_count))
        return self._weighing.weigh_far(
            partial(self._likelihood.linearize, moments), before.errors, covariance, moments.count, first.excess
        )

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
            information = information + step.here.information
            # Moved from the errors at which the block was linearised to those before all of them.
            moved = (step.before.errors.to_vector() - before.before.errors.to_vector()).ravel()
            gradient = gradient + step.here.gradient + information @ moved
            count += step.moments.count
            sums.append(_Sums(before, information, gradient, count))
        return sums[::-1]
