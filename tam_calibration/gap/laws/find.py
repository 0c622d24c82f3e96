"""The search for the laws of a gap: the one of most evidence, then those of what it leaves."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.gap.laws.candidates import Candidate, candidates
from tam_calibration.gap.laws.decisions import (
    FREEDOM,
    LEAST_EVIDENCE,
    LEAST_SHARE,
    MOST_LAWS,
    NEARLY,
    SAME_LAW,
    TIE,
    TOLERANCE,
)
from tam_calibration.gap.laws.evidence import Sums, constant, course
from tam_calibration.gap.laws.patterns import sharp_attitudes, switched_gains
from tam_calibration.gap.laws.states import jumping, sharpened
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.gap.repeats import Repeats, repeats
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Found:
    """A law that was found, the energy that it predicts, and the others tried, the best first.

    Parameters
    ----------
    best : Candidate
    predicted : float
        Energy of every other sample that it predicts from those between, in units of the noise.
    others : tuple of Candidate
    residual : Residual
        In which it was found.
    """

    best: Candidate
    predicted: float
    others: tuple[Candidate, ...]
    residual: Residual

    def left_in(self, residual: Residual) -> float:
        """Return the energy, in units of the noise, that the same law fitted anew predicts of another residual.

        Parameters
        ----------
        residual : Residual
            Of the same samples, such as with a cause taken off.
        """
        return predicted_energy(self.alike(residual), self.best) / self.residual.noise

    def taken_off(self, residual: Residual) -> Residual:
        """Return another residual of the same samples without the law, fitted anew."""
        alike = self.alike(residual)
        factor = self.residual.noise**-0.5
        return residual.without(self.best.signal(residual.scaled(factor), self.best.fitted(alike)) * factor)

    def alike(self, residual: Residual) -> Residual:
        """Return another residual with the samples and in the units of the one in which the law was found.

        Parameters
        ----------
        residual : Residual
            Of the same recording.
        """
        return residual.taking(self.residual.live).scaled(self.residual.noise**-0.5)


def predictive_laws(residual: Residual, positions_m: FloatArray, whole: float) -> tuple[list[Found], Residual]:
    """Return the laws that predict samples from others, the strongest first, and the residual without them.

    Parameters
    ----------
    residual : Residual
        Of the samples that count.
    positions_m : (K, 3) array
        Of the sensors.
    whole : float
        Energy of the gap, of which the laws have their shares.
    """
    found: list[Found] = []
    again = repeats(residual.pose)
    for _ in range(MOST_LAWS):
        if residual.excess < 2 * np.sqrt(2.0 * residual.size) and found:
            break
        error = TOLERANCE**2 * max(residual.excess, 0.0) / residual.size
        factor = float(np.sqrt(max(1 + error, residual.white)))
        scaled = residual.scaled(factor)
        tried = candidates(scaled, positions_m)
        tried = sorted([*tried, *_refined(scaled, tried)], key=lambda one: -one.evidence)
        tried = [one for one in tried if again is None or not _is_of_pose(scaled, one, again)]
        accepted = next(_accepted(scaled, tried), None)
        if accepted is None:
            break
        best, predicted = accepted
        predicted *= factor**2
        if found and predicted < LEAST_SHARE * max(whole, residual.excess, 1.0):
            break
        found.append(Found(best, predicted, tuple(tried), scaled))
        residual = residual.without(best.signal(scaled, best.fitted(scaled)) * factor)
    return found, residual


def _refined(residual: Residual, tried: list[Candidate]) -> Iterator[Candidate]:
    """Yield courses that jump, courses along one direction, and sharper functions of direction, of the best laws."""
    top = tried[0].evidence
    if top < LEAST_EVIDENCE:
        return
    timed = [one for one in tried if one.course in ("slow", "random", "step", "tone") and one.evidence > 0.7 * top]
    seen: set[int] = set()
    jumps: list[Candidate] = []
    for one in timed:
        if (
            one.pattern.law in ("offset", "gain")
            and one.course != "tone"
            and id(one.pattern) not in seen
            and len(seen) < 5
        ):
            seen.add(id(one.pattern))
            jumps += jumping(residual, one.pattern)
    gains = [one for one in timed if one.pattern.law == "gain" and one.pattern.sensors != ("scalar",)]
    if gains:
        for pattern in switched_gains(residual, int(gains[0].pattern.sensors[0])):
            if pattern.axes == gains[0].pattern.axes or len(pattern.axes) == 3:
                jumps += jumping(residual, pattern)
    yield from jumps
    jumps = sorted((one for one in jumps if one.begins_on is not None), key=lambda one: -one.evidence)
    for one in jumps[:4]:
        if one.evidence > 0.8 * top and one.bins is not None and one.bins.order.shape[1] > 1:
            fine = sharpened(residual, one)
            if fine is not None:
                yield fine
    for one in [one for one in timed if one.bins is not None and not one.steps and one.course != "tone"][:3]:
        yield from _along_one_direction(residual, one)
    by_motion = [one for one in tried if one.pattern.law == "attitude" and len(one.pattern.sensors) == 1]
    if timed and timed[0] is tried[0] and by_motion and by_motion[0].evidence > 0.4 * top:
        first = by_motion[0].pattern
        if first.sensors != ("scalar",):
            pattern = sharp_attitudes(residual, int(first.sensors[0]), first.axes)
            fit = constant(pattern.columns(residual), residual.z, residual.nuisance)
            yield Candidate(pattern, "motion", fit.evidence, "attitude")


def _along_one_direction(residual: Residual, one: Candidate) -> Iterator[Candidate]:
    """Yield a course with a pattern that stays: the direction in which its coefficients go together."""
    assert one.bins is not None
    sums = Sums.of(one.pattern.columns(residual), residual.z, residual.nuisance, one.bins)
    if sums.score.shape[1] < 2:
        return
    fit = course(sums, one.length, np.array([one.variance]))
    direction = np.linalg.svd(fit.mean, full_matrices=False)[2][0]
    variances = one.variance * np.array([1.0, len(direction)])
    single = course(sums.along(direction), one.length, variances)
    penalty = 0.5 * len(direction) * np.log(residual.count)
    yield replace(one, evidence=single.evidence - penalty, direction=direction, variance=single.variance)


def _accepted(residual: Residual, tried: list[Candidate]) -> Iterator[tuple[Candidate, float]]:
    """Yield laws that predict, the simplest of those with about the most evidence first, with the energy predicted."""
    for first in tried[:6]:
        if first.evidence < LEAST_EVIDENCE:
            return
        simpler = [
            one
            for one in tried
            if first.evidence - TIE - _behind(one, first) * first.evidence <= one.evidence <= first.evidence
        ]
        simpler = [one for one in simpler if one is first or _freedom(one) <= _freedom(first) - 1]
        best = min(simpler, key=lambda one: (_freedom(one), -one.evidence))
        predicted = predicted_energy(residual, best)
        if predicted > LEAST_EVIDENCE:
            yield best, predicted


def _is_of_pose(residual: Residual, one: Candidate, again: Repeats) -> bool:
    """Say whether a course in time is the same at every pose that is taken up again."""
    if one.course not in ("step", "episodes", "slow", "random", "tone") or one.evidence < LEAST_EVIDENCE:
        return False
    return again.are_same(one.signal(residual, one.fitted(residual)))


def _behind(one: Candidate, first: Candidate) -> float:
    """Return the part of the evidence by which a simpler law may be behind: more for another course of the same law."""
    same = (one.pattern.law, one.pattern.sensors) == (first.pattern.law, first.pattern.sensors)
    return SAME_LAW if same else NEARLY


def _freedom(one: Candidate) -> float:
    return FREEDOM[one.course] + FREEDOM[one.pattern.law] + (len(one.pattern.sensors) > 1)


def predicted_energy(residual: Residual, law: Candidate) -> float:
    """Return the energy of every other sample that a law fitted to the samples between predicts."""
    even = np.arange(residual.count) % 2 == 0
    fallen = 0.0
    for chosen in (even, ~even):
        training, rest = residual.taking(chosen), residual.taking(~chosen)
        signal = law.signal(rest, law.fitted(training))
        flat = rest.nuisance.reshape(signal.size, -1)
        signal = signal - (flat @ (flat.T @ signal.ravel())).reshape(signal.shape)
        fallen += float((rest.z**2).sum() - ((rest.z - signal) ** 2).sum())
    return max(fallen, 0.0)
