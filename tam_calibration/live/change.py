"""Whether the sensors have changed since a moment, which of them and what: a generalised likelihood ratio.

Before that moment the errors were x ~ N(x₀, P). Samples since then have at x₀ the information I and the gradient
g ~ N(I (x - x₀ + B δ), I), where B δ is a change of the errors along the columns of B. With the unknown x integrated
out, W = (1 + I P)⁻¹ I is the information that the samples give of changes, and s = (1 + I P)⁻¹ g its score: without a
change Λ = sᵀ B (Bᵀ W B)⁻¹ Bᵀ s is a χ² of as many degrees of freedom as B has columns, and the most probable change
is (Bᵀ W B)⁻¹ Bᵀ s (Willsky and Jones 1976).

The last half minute of samples is kept in blocks. They are weighed against what was known before them. The first alarm
says that there is a change, and when it may have come at the earliest; it may have come within the block that raised
it. What has changed is therefore told by the blocks after that one alone, against what was known before the earliest
moment.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy.special import chdtri

from tam_calibration.core.least_squares import scaled
from tam_calibration.fit.contradiction import FAR_RATIO, Hypothesis, changes_of_sensors
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.fit.posterior import can_be
from tam_calibration.fit.prior import Prior
from tam_calibration.live.block_noise import BlockMeans, noise_of
from tam_calibration.live.recursion import Belief, MomentLikelihood, SampleMoments, Walk
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.change_rates import DAY_S
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla

CLEAR_RATIO = 2 * float(np.log(100.0))
"""By how much a ratio exceeds another that is ruled out: the data are then a hundred times less probable by that."""

_MOST_STEPS, _SETTLED = 20, 1e-6
"""Steps to a change, and the part that the last may leave: six lead to the right one, wrong ones may not settle."""

_UNSEEN = 1e-9
"""Information along a direction, over that of its unknowns known alone, below which it is not seen: above rounding."""

_TOLD_FROM = 3.0
"""Standard errors from which a component of a change is told."""


GRADIENT = "gradient of the field"


def hypotheses(errors: SensorErrors, array: Array) -> tuple[Hypothesis, ...]:
    """Return what may have changed: errors of an array's sensors, or that it is near a source.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors.
    array : Array
        Where they are.
    """
    changes, count = changes_of_sensors(errors), errors.sensor_count
    if not array.has_gradient:
        return changes
    biases = np.eye(12 * count).reshape(12 * count, count, 12)[:, :, 6:9].reshape(12 * count, -1)
    fields = np.einsum("kij,cjl,kl->kic", errors.matrix, UNIT_TENSORS, array.positions_m).reshape(3 * count, 5)
    return (*changes, Hypothesis(f"{GRADIENT}, as near a source", GRADIENT, 0, biases @ fields, (), "T/m"))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What samples say of a hypothesis.

    Parameters
    ----------
    hypothesis : Hypothesis
        What may have changed.
    size : (M,) array
        Most probable change of its unknowns.
    covariance : (M, M) array
        Of these; infinite on the diagonal for what is not seen.
    ratio : float
        Twice the logarithm of the likelihood ratio against no change.
    score : float
        The ratio less what its unknowns gain by chance (Schwarz 1978).
    """

    hypothesis: Hypothesis
    size: FloatArray
    covariance: FloatArray
    ratio: float
    score: float

    @property
    def change(self) -> FloatArray:
        """(12 K,) most probable change of the errors, SI."""
        return self.hypothesis.directions @ self.size

    @property
    def reach(self) -> FloatArray:
        """(M,) sizes that the change may have; of unknowns that are not seen that of the largest that is."""
        variance = np.diag(self.covariance)
        reach = np.sqrt(self.size**2 + np.where(np.isfinite(variance), variance, 0.0))
        reach[~np.isfinite(variance)] = reach.max()
        return reach

    @property
    def sentence(self) -> str:
        """What has changed and by how much, for people."""
        errors = np.sqrt(np.diag(self.covariance))
        told = [
            f"{name} {_told(value, self.hypothesis.unit)} ± {_told(error, self.hypothesis.unit, '')}".strip()
            for name, value, error in zip(self.hypothesis.components, self.size, errors, strict=False)
            if abs(value) > _TOLD_FROM * error
        ]
        unit = {"T": " nT", "rad": "°", "1": " ppm"}.get(self.hypothesis.unit, "")
        return self.hypothesis.name + (f" by {', '.join(told)}{unit}" if told else "")


def _told(value: float, unit: str, form: str = "+") -> str:
    shown = {"T": to_nanotesla, "rad": to_degrees}.get(unit, _to_ppm)(float(value))
    return f"{shown:{form}.3g}"


def _to_ppm(part: float) -> float:
    return 1e6 * part


class Weighing:
    """Weighs hypotheses against each other by samples.

    Parameters
    ----------
    among : sequence of Hypothesis
        The hypotheses.
    chance : float
        Of a ratio of one of them, without a change, from which it is believed.
    """

    def __init__(self, among: Sequence[Hypothesis], chance: float) -> None:
        self._among = among
        self._unknowns = np.array([each.directions.shape[1] for each in among])
        self._thresholds = chdtri(self._unknowns, chance)
        self._alike = [np.flatnonzero(self._unknowns == unknowns) for unknowns in np.unique(self._unknowns)]
        self._directions = [np.stack([among[int(index)].directions for index in alike]) for alike in self._alike]

    def weigh(
        self, information: FloatArray, gradient: FloatArray, covariance: FloatArray, count: int, excess: float
    ) -> tuple[Evidence, ...]:
        """Return the most probable hypothesis and those that are not clearly less so, or none where it may be chance.

        Parameters
        ----------
        information, gradient : (12 K, 12 K) and (12 K,) arrays
            Of the samples, at the errors before them, by the errors, SI.
        covariance : (12 K, 12 K) array
            Of the errors before the samples.
        count : int
            Number of the samples.
        excess : float
            Variance of the residuals over that which the noise is stated to have.
        """
        of_changes, score = _marginal(information, gradient, covariance)
        ratios = np.empty(len(self._among))
        for alike, directions in zip(self._alike, self._directions, strict=True):
            turned = np.swapaxes(directions, 1, 2)
            unit, scale = scaled(turned @ of_changes @ directions)
            along = (turned @ score) / scale
            solved = np.linalg.solve(unit + _UNSEEN * np.eye(unit.shape[-1]), along[..., None])[..., 0]
            ratios[alike] = np.sum(along * solved, axis=1) / excess
        scores = ratios - self._unknowns * np.log(max(count, 2))
        order = np.argsort(-scores)
        if ratios[order[0]] <= self._thresholds[order[0]]:
            return ()
        not_out = order[scores[order[0]] - scores[order] <= CLEAR_RATIO]
        return tuple(
            self._evidence(index, of_changes, score, float(scores[index]), excess) for index in not_out.tolist()
        )

    def weigh_far(
        self,
        linearize: Callable[[SensorErrors], Linearization],
        before: SensorErrors,
        covariance: FloatArray,
        count: int,
        excess: float,
    ) -> tuple[Evidence, ...]:
        """Return the same of a change so large that lengths are no straight lines over it: each is fitted by itself.

        Parameters
        ----------
        linearize : callable
            From errors to what the samples say there.
        before : SensorErrors
            Before the samples.
        covariance, count, excess
            As of ``weigh``.
        """
        without, found = linearize(before), list[Evidence]()
        for index in range(len(self._among)):
            fitted = self._fitted(index, linearize, before, covariance, excess)
            if fitted is not None:
                evidence, here = fitted
                fall = without.differential + without.common_mode - here.differential - here.common_mode
                score = fall / excess - float(self._unknowns[index]) * np.log(max(count, 2))
                found.append(replace(evidence, ratio=fall / excess, score=score))
        found.sort(key=lambda evidence: -evidence.score)
        return tuple(evidence for evidence in found if found[0].score - evidence.score <= CLEAR_RATIO)

    def _fitted(
        self,
        index: int,
        linearize: Callable[[SensorErrors], Linearization],
        before: SensorErrors,
        covariance: FloatArray,
        excess: float,
    ) -> tuple[Evidence, Linearization] | None:
        """Return what a hypothesis comes to, and what the samples say there; None where no sensors are like that."""
        start = before.to_vector().ravel()
        change = np.zeros_like(start)
        here = linearize(before)
        for _ in range(_MOST_STEPS):
            evidence = self._evidence(
                index, *_marginal(here.information, here.gradient + here.information @ change, covariance), 0.0, excess
            )
            left, change = evidence.change - change, evidence.change
            vector = (start + change).reshape(-1, 12)
            if not can_be(vector):
                return None
            here = linearize(SensorErrors.from_vector(vector, before.orientation))
            if np.abs(left).max() <= _SETTLED * np.abs(change).max():
                break
        return evidence, here

    def _evidence(self, index: int, of_changes: FloatArray, score: FloatArray, net: float, excess: float) -> Evidence:
        hypothesis = self._among[int(index)]
        directions = hypothesis.directions
        unit, scale = scaled(directions.T @ of_changes @ directions)
        values, vectors = np.linalg.eigh(unit)
        seen = values > _UNSEEN
        along = vectors[:, seen] / scale[:, None]
        size = along / values[seen] @ (along.T @ (directions.T @ score))
        covariance = excess * along / values[seen] @ along.T
        is_open = np.abs(vectors[:, ~seen]).max(axis=1, initial=0.0) > np.sqrt(_UNSEEN)
        covariance[is_open, is_open] = np.inf
        ratio = float(size @ (directions.T @ score)) / excess
        return Evidence(hypothesis, size, covariance, ratio, net)


def _marginal(information: FloatArray, gradient: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return information (12 K, 12 K) and score (12 K,) of changes, the errors before them integrated out."""
    unit, scale = scaled(information)
    before = covariance * np.outer(scale, scale)
    right = np.column_stack([unit, gradient / scale])
    solved = np.linalg.solve(np.eye(len(scale)) + unit @ before, right)
    return (solved[:, :-1] + solved[:, :-1].T) / 2 * np.outer(scale, scale), solved[:, -1] * scale


BLOCK_S = 2.0
"""Time that a block spans, seconds: short beside what may pass until a change is told, and long enough that solving for
the errors anew with each block costs little."""

WINDOW = 15
"""Blocks within which a change is looked for, half a minute: what comes more slowly is learned as a drift."""

DECIDE_S = 20.0
"""Time from a change to when it is told in any case, seconds: what cannot be told apart by then is told as such. With
the blocks in which it begins and ends it is told within half a minute."""

MOST_AFTER = int(DECIDE_S / BLOCK_S)
"""Blocks that are looked at while something passes: once these show nothing it has passed."""

UNSTEADY = 0.01
"""Probability of what a change leaves, by chance, below which it is none: of a change of the sensors as it came."""

BENT = 1e-3
"""Part of what a change explains that it may leave: over large changes lengths are no straight lines."""

PASSING = 3.0
"""Change of the intensity from block to block over what sensors differ by, from which a source passes: on a vehicle of
1 m/s, whose sensors are 0.25 m from their centre, that of a distant source is eight."""

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
    vector = (first.before.errors.to_vector().ravel() + evidence.change).reshape(-1, 12)
    errors = SensorErrors.from_vector(vector, first.before.errors.orientation)
    values_T = np.array([step.means.at(errors) for step in after])
    variance_T2 = noise_of(after[0].likelihood.array) ** 2
    weight = np.array([_counts(step, values_T.shape[1]) for step in after]) / variance_T2
    left_T = values_T - np.sum(weight * values_T, axis=0) / np.maximum(weight.sum(axis=0), np.finfo(float).tiny)
    freedom = (len(after) - 1) * (3 * errors.sensor_count - 2)
    if freedom and float(np.sum(weight * left_T**2)) > max(chdtri(freedom, UNSTEADY), BENT * evidence.ratio):
        return True
    seen_T = np.abs(np.mean([step.means.at(first.before.errors) for step in after], axis=0)).max()
    intensity_T = np.array([step.means.intensity_T for step in (first, *after)])
    return bool(np.abs(np.diff(intensity_T)).max() > PASSING * seen_T)


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
        if found and _passes(found[0], self._first, self._after):
            self._after = self._after[-MOST_AFTER:]
            return Suspicion(self._first, tuple(self._after), (), False)
        is_late = not 0 <= end_s - self._first.begin_s < DECIDE_S
        is_decided = len(self._after) >= FEWEST_AFTER and (len(found) < 2 or is_late)
        return Suspicion(self._first, tuple(self._after), found, is_decided)

    def _weigh_far(self, first: Step, after: list[Step], end_s: float, temperature_C: float) -> tuple[Evidence, ...]:
        before = first.before
        covariance = before.covariance + self._walk.covariance(before, end_s, temperature_C)
        moments = sum((step.moments for step in after), SampleMoments.none(before.errors.sensor_count))
        return self._weighing.weigh_far(
            partial(after[-1].likelihood.linearize, moments), before.errors, covariance, moments.count, first.excess
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
