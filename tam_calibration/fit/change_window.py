"""The last half minute of samples in blocks, and whether the sensors have changed within it.

The blocks after each moment of the window are weighed against what was known at that moment. A change may lie anywhere
in the block that follows it, which is therefore not among them.
"""

from collections import deque
from typing import NamedTuple

import numpy as np

from tam_calibration.fit.change import Evidence, Weighing, hypotheses
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.recursion import Belief, Walk
from tam_calibration.fit.sample_moments import SampleMoments
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
"""Blocks after that in which a change comes from which it is told: the first may be that in which it comes."""

FALSE_ALARMS_A_DAY = 0.1
"""Bound of their expected number: the chance of each test is this over all tests of a day, as if all were independent.
One in ten days leaves room for noise that is not quite normal."""


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
    step : Step
        The block in which it came.
    after : tuple of Step
        Those after it.
    found : tuple of Evidence
        What has changed, the most probable first, and what is not clearly less so.
    is_decided : bool
        Whether it is clear, or time to tell it.
    """

    step: Step
    after: tuple[Step, ...]
    found: tuple[Evidence, ...]
    is_decided: bool


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
        self._weighing = Weighing(hypotheses(prior.errors, prior.calibration.array))
        self._steps: deque[Step] = deque(maxlen=WINDOW)

    @property
    def is_full(self) -> bool:
        """Whether it spans half a minute."""
        return len(self._steps) == WINDOW

    @property
    def chance(self) -> float:
        """Chance of a false alarm in one test of one hypothesis."""
        return FALSE_ALARMS_A_DAY * BLOCK_S / DAY_S / WINDOW / len(self._weighing)

    def clear(self) -> None:
        """Forget the blocks: what they say of changes has been told."""
        self._steps.clear()

    def add(self, step: Step, end_s: float, temperature_C: float) -> Suspicion | None:
        """Add a block, and return the most probable change; None where there may be none.

        Parameters
        ----------
        step : Step
            The block.
        end_s, temperature_C : float
            At its end.
        """
        self._steps.append(step)
        steps, suspected, best = tuple(self._steps), None, -np.inf
        information, gradient, count = np.zeros((self._size, self._size)), np.zeros(self._size), 0
        for index in range(len(steps) - 2, -1, -1):
            first, second = steps[index], steps[index + 1]
            information = information + second.here.information
            # Moved from the errors at which the next block was linearised to those before all of them.
            moved = (second.before.errors.to_vector() - first.before.errors.to_vector()).ravel()
            gradient = gradient + second.here.gradient + information @ moved
            count += second.moments.count
            covariance = first.before.covariance + self._walk.covariance(first.before, end_s, temperature_C)
            found = self._weighing.weigh(information, gradient, covariance, count, first.excess)
            score = found[0].score + _share(first.here, found[0].change)
            if found[0].exceeds(self.chance) and score > best:
                after = steps[index + 1 :]
                best, suspected = score, Suspicion(first, after, found, _is_decided(first, after, end_s, found))
        return suspected


def _is_decided(first: Step, after: tuple[Step, ...], end_s: float, found: tuple[Evidence, ...]) -> bool:
    """Whether a change is clear, or it is time to tell it."""
    return (len(found) == 1 and len(after) >= FEWEST_AFTER) or not 0 <= end_s - first.begin_s < DECIDE_S


def _share(here: Linearization, change: FloatArray) -> float:
    """Return by how much the likelihood of the block in which a change comes rises, if a part of it has the change.

    Without that the moment before it would be preferred, since it has more samples after it.
    """
    along, square = float(change @ here.gradient), float(change @ here.information @ change)
    part = min(max(along / square, 0.0), 1.0) if square > 0 else 0.0
    return 2 * part * along - part**2 * square
