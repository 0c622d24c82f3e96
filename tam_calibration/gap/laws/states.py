"""Courses that jump: between two states, or in a few steps."""

from collections.abc import Iterator
from itertools import accumulate, islice
from math import log

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.states import MOST_STEPS, Times
from tam_calibration.gap.laws.decisions import SLOW
from tam_calibration.gap.laws.evidence import Bins, Sums, course, of_normal
from tam_calibration.gap.laws.patterns import Candidate, Pattern, switched_gains
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


def jumping(residual: Residual, pattern: Pattern) -> Iterator[Candidate]:
    """Yield the courses of a pattern with two states, and with a few steps."""
    bins = Bins.of_time(residual.time_s)
    sums = pattern.sums(residual, bins)
    yield from steps(pattern, sums, bins)
    variance = np.array([max(residual.excess, 1.0) / residual.count])
    for length in (0.06, 0.008):
        mean = course(sums, length * float(np.ptp(residual.time_s)), variance).mean
        along = np.linalg.svd(mean - mean.mean(axis=0), full_matrices=False)[2][0]
        candidate = _two_states(pattern, sums, bins, _parted(mean @ along))
        if candidate is not None:
            yield candidate


def change_times(residual: Residual, pattern: Pattern, whole: Residual) -> Times:
    """Return the times of courses of a pattern that jump: in one step to a few, and between two states.

    Parameters
    ----------
    residual : Residual
        In which the pattern is a law.
    pattern : Pattern
        That comes and goes.
    whole : Residual
        The same with the samples that lie far off, as those beside a large change do.
    """
    if pattern.law == "gain":
        # A gain amplifies the bias too.
        both = switched_gains(residual, int(pattern.sensors[0]))
        pattern = next(one for one in both if one.axes == pattern.axes)
    bins = Bins.of(residual.time_s, residual.count)
    quiet, every = (pattern.sums(one, bins) for one in (residual, whole))
    stepping = list(islice(steps(pattern, quiet, bins), MOST_STEPS))
    fine = (sharpened(residual, one) for one in jumping(residual, pattern) if one.begins_on is not None)
    states = [_state(one, residual.count) for one in (*stepping, *fine) if one is not None]
    found = [*states[: len(stepping)], *(_polished(every, state) for state in states)]
    return tuple(dict.fromkeys(_times_of(state, residual.time_s) for state in found))


def _state(one: Candidate, count: int) -> NDArray[np.bool_]:
    """Return in which samples (N,) a course is in the second of two states that it goes through in turn."""
    return np.asarray((one.passed(count) + (one.begins_on or False)) % 2 == 1)


def _polished(sums: Sums, state: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return states (B,) with their changes moved, bin by bin, as long as two levels explain more."""
    state, totals = state.copy(), _of_state(sums, state)
    best, is_better = _explained(*totals), True
    while is_better:
        is_better = False
        for at in np.flatnonzero(np.diff(state.astype(int))).tolist():
            for moved in (at, at + 1):
                sign = -1 if state[moved] else 1
                own = sums.information[moved], sums.score[moved], sums.cross[moved]
                tried = tuple(one + sign * change for one, change in zip(totals, own, strict=True))
                if (explained := _explained(*tried)) > best:
                    state[moved], totals, best, is_better = not state[moved], tried, explained, True
                    break
    return state


def _explained(information: FloatArray, score: FloatArray, cross: FloatArray) -> float:
    """Return the energy that a change of a pattern explains beside the nuisance directions."""
    own = information - cross @ cross.T
    return float(score @ np.linalg.solve(own + 1e-9 * (np.trace(own) + 1e-9) * np.eye(len(own)), score))


def _times_of(state: NDArray[np.bool_], time_s: FloatArray) -> tuple[float, ...]:
    """Return the times between samples (N,) of steps, or at which the rarer of two states begins and ends in turn."""
    edges = np.flatnonzero(np.diff(state.astype(int))) + 1
    times = ((time_s[edges - 1] + time_s[edges]) / 2).tolist()
    begins_on = bool(state[0]) != bool(state.mean() > 1 / 2)
    return ((3 * time_s[0] - time_s[1]) / 2, *times) if begins_on and len(times) > MOST_STEPS else tuple(times)


def sharpened(residual: Residual, one: Candidate) -> Candidate | None:
    """Return a course between two states with the changes found to the sample."""
    bins = Bins.of(residual.time_s, residual.count)
    return _two_states(one.pattern, one.pattern.sums(residual, bins), bins, _state(one, residual.count))


def _two_states(pattern: Pattern, sums: Sums, bins: Bins, state: NDArray[np.bool_]) -> Candidate | None:
    """Return the course between two states, from a first guess of when the second of them holds."""
    switch = log(len(state))
    for _ in range(6):
        if state.all() or not state.any():
            return None
        information, score, cross = _of_state(sums, state)
        own = information - cross @ cross.T
        change = np.linalg.solve(own + 1e-6 * (np.trace(own) + 1e-9) * np.eye(len(own)), score)
        gain = (sums.score + sums.cross @ (cross.T @ change)) @ change
        gain = gain - 0.5 * np.einsum("bij,i,j->b", sums.information, change, change)
        found = _best_path(gain, switch)
        if (found == state).all():
            break
        state = found
    if state.all() or not state.any():
        return None
    information, score, cross = _of_state(sums, state)
    evidence = of_normal(information - cross @ cross.T, score, np.ones(len(score))).evidence
    changes = np.flatnonzero(np.diff(state.astype(int)) != 0) + 1
    label = "step" if len(changes) <= 2 else "episodes"
    edges = tuple(int(one) for one in changes)
    return Candidate(pattern, label, evidence - len(changes) * switch, bins, 0.0, 1.0, edges, bool(state[0]))


def _of_state(sums: Sums, state: NDArray[np.bool_]) -> tuple[FloatArray, FloatArray, FloatArray]:
    return sums.information[state].sum(axis=0), sums.score[state].sum(axis=0), sums.cross[state].sum(axis=0)


def _parted(values: FloatArray) -> NDArray[np.bool_]:
    """Return which values (B,) are in the upper of the two groups that differ most (Otsu 1979)."""
    order = np.sort(values)
    count = np.arange(1, len(order))
    total = np.cumsum(order)
    between = (total[:-1] / count - (total[-1] - total[:-1]) / (len(order) - count)) ** 2 * count * (len(order) - count)
    return np.asarray(values > order[int(between.argmax())])


def _best_path(gain: FloatArray, switch: float) -> NDArray[np.bool_]:
    """Return the most likely states (B,) for log odds of the second state, each change at a cost (Viterbi)."""
    # Log odds by all samples up to each. Those beyond the cost of a change decide; others leave it to the next.
    odds = np.array(list(accumulate(gain.tolist(), lambda one, more: min(max(one, -switch), switch) + more)))
    is_decided = np.abs(odds) > switch
    is_decided[-1] = True
    index = np.where(is_decided, np.arange(len(odds)), len(odds))
    return np.asarray(odds[np.minimum.accumulate(index[::-1])[::-1]] > 0)


def steps(pattern: Pattern, sums: Sums, bins: Bins) -> Iterator[Candidate]:
    """Yield the courses of one step to a few, each step where it explains most beside the others.

    An offset may have more, where each adds evidence, as many as slow courses have room for: gains on so many parts
    imitate any course. The last ones are without those of the first steps that later ones replace.
    """
    after = [np.cumsum(one[::-1], axis=0)[::-1] for one in (sums.information, sums.score, sums.cross)]
    count, edges, best = len(sums.place), list[int](), -np.inf

    def at(edges: list[int]) -> Candidate:
        information, score = _joint(after, edges)
        evidence = of_normal(information, score, np.ones(len(score))).evidence - len(edges) * np.log(count)
        return Candidate(pattern, "step", evidence, bins, 0.0, 1.0, tuple(edges))

    while len(edges) < (1 // SLOW if pattern.law == "offset" else MOST_STEPS):
        edges = sorted([*edges, _next_step(after, edges, count)])
        found = at(edges)
        if len(edges) > MOST_STEPS and found.evidence < best:
            break
        best = found.evidence
        yield found
    while len(edges) > MOST_STEPS:
        fewer = max((at([one for one in edges if one != left]) for left in edges), key=lambda one: one.evidence)
        if fewer.evidence < found.evidence:
            break
        found, edges = fewer, list(fewer.steps)
        yield found


def _joint(after: list[FloatArray], edges: list[int]) -> tuple[FloatArray, FloatArray]:
    """Return the normal equations of steps at some bins, beside the nuisance directions."""
    information, score, cross = after
    later = np.maximum.outer(edges, edges)
    blocks = np.block([[information[at] for at in row] for row in later.tolist()])
    crossed = np.concatenate([cross[at] for at in edges])
    return blocks - crossed @ crossed.T, np.concatenate([score[at] for at in edges])


def _next_step(after: list[FloatArray], edges: list[int], count: int) -> int:
    """Return the bin at which a further step explains most."""
    information, score, cross = after
    width = score.shape[1]
    own = information - cross @ np.swapaxes(cross, 1, 2)
    rest = score
    if edges:
        known, known_score = _joint(after, edges)
        known = known + 1e-9 * np.trace(known) * np.eye(len(known))
        bins = np.arange(count)
        beside = np.concatenate([information[np.maximum(bins, at)] - cross @ cross[at].T for at in edges], axis=2)
        solved = np.linalg.solve(known, np.swapaxes(beside, 1, 2).reshape(count, len(known), width))
        own = own - beside @ solved
        rest = score - beside @ np.linalg.solve(known, known_score)
    fixed = own + (1e-6 * np.trace(own, axis1=1, axis2=2).max() + 1e-9) * np.eye(width)
    gain = (rest * np.linalg.solve(fixed, rest[:, :, None])[:, :, 0]).sum(axis=1)
    gain[[0, *edges]] = -np.inf
    return int(gain.argmax())
