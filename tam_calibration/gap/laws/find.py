"""The search for the laws of a gap: the one of most evidence, then those of what it leaves."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.grades import FEWEST, MINOR, MOST, NEGLIGIBLE, NOTABLE, SLIGHT
from tam_calibration.effects.states import MOST_STEPS
from tam_calibration.gap.laws.candidates import candidates
from tam_calibration.gap.laws.decisions import FREEDOM, LEAST_EVIDENCE, LEAST_SHARE, MOST_TRIED, TIE, TOLERANCE
from tam_calibration.gap.laws.law import Course, Place
from tam_calibration.gap.laws.patterns import Candidate, switched_gains
from tam_calibration.gap.laws.sensors import in_its_sensors
from tam_calibration.gap.laws.states import jumping, sharpened
from tam_calibration.gap.laws.whitened import Residual
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Repeats:
    """Visits to poses, and the pairs of visits to the same pose.

    Parameters
    ----------
    visit : (N,) array of int
        Number of the visit that a sample is part of.
    first, second : (P,) array of int
        Visits to the same pose.
    tolerance : float
        Part by which a signal may differ between them.
    """

    visit: NDArray[np.intp]
    first: NDArray[np.intp]
    second: NDArray[np.intp]
    tolerance: float = SLIGHT

    def energy(self, residual: FloatArray) -> float:
        """Return the mean product of a residual (N, C) at both visits to a pose, to which noise adds nothing."""
        means = _means(self.visit, residual)
        return float((means[self.first] * means[self.second]).sum(axis=1).mean())

    def are_same(self, signal: FloatArray) -> bool:
        """Return whether a signal (N, C) is the same at both visits to a pose."""
        means = _means(self.visit, signal)
        between = means[self.first] - means[self.second]
        either = np.concatenate([means[self.first], means[self.second]])
        # Sums, as one sensor alone has no channel between sensors.
        return float(np.sum(between**2)) / len(between) < 2 * self.tolerance * float(np.sum(either.var(axis=0)))


def repeats(pose: FloatArray) -> Repeats | None:
    """Return the visits to poses, where most poses are taken up again; None elsewhere.

    Parameters
    ----------
    pose : (N, p) array
        Vectors of length one that tell the pose: axes of the array in the world, or the field in the array.
    """
    from scipy.spatial import cKDTree

    moved = np.linalg.norm(np.diff(pose, axis=0), axis=1) > NEGLIGIBLE
    visit = np.append(0, np.cumsum(moved))
    if visit[-1] < FEWEST:
        return None
    poses = _means(visit, pose)
    distance, partner = (found[:, 1] for found in cKDTree(poses).query(poses, 2))
    again = np.flatnonzero(distance < NEGLIGIBLE)
    return Repeats(visit, again, partner[again]) if len(again) > MOST * len(poses) else None


def near_repeats(residual: Residual) -> Repeats | None:
    """Return pairs of samples with about one direction of the field, far apart in time; None where few have one.

    A gain that is on for half of the time makes errors half of which are the same at both.
    """
    from scipy.spatial import cKDTree

    part = np.arange(residual.count) * 8 // residual.count
    pairs = []
    for before in range(8):
        for after in range(before + 3, 8):  # a quarter of the time later, at least
            early, late = np.flatnonzero(part == before), np.flatnonzero(part == after)
            distance, partner = cKDTree(residual.field[late]).query(residual.field[early])
            near = distance < NOTABLE  # radians, within which smooth functions of direction change little
            pairs.append(np.column_stack([early[near], late[partner[near]]]))
    first, second = np.concatenate(pairs).T
    is_enough = len(np.unique(np.append(first, second))) > NOTABLE * residual.count
    return Repeats(np.arange(residual.count), first, second, NOTABLE) if is_enough else None


def _means(visit: NDArray[np.intp], values: FloatArray) -> FloatArray:
    """Return the mean (V, C) of values (N, C) over each visit."""
    sums = np.array([np.bincount(visit, one) for one in values.T]).T
    return np.asarray(sums / np.bincount(visit)[:, None])


@dataclass(frozen=True, eq=False)
class Found:
    """A law that was found, the energy that it predicts, and those that cannot be told from the best, it included.

    Parameters
    ----------
    best : Candidate
    predicted : float
        Energy of half of the samples that it predicts from the others, in units of the noise.
    others : tuple of Candidate
    residual : Residual
        In which it was found.
    shared : Candidate
        The law in all sensors in which it is, with its course; the best one where it is in those alone.
    is_of_two : bool
        Whether it is one of two laws that replace one with a free course.
    """

    best: Candidate
    predicted: float
    others: tuple[Candidate, ...]
    residual: Residual
    shared: Candidate
    is_of_two: bool = False

    def left_in(self, residual: Residual) -> float:
        """Return the energy, in units of the noise, that the same law fitted anew predicts of another residual.

        Parameters
        ----------
        residual : Residual
            Of the same samples, such as with a cause taken off.
        """
        return predicted_energy(_halves(self.alike(residual)), self.shared) / self.residual.noise

    def signal(self, residual: Residual, training: Residual) -> FloatArray:
        """Return what the law adds to the channels (N, C) of a residual, fitted to one in the units of its own."""
        return np.asarray(self.shared.signal(residual, training) * self.residual.noise**-0.5)

    def alike(self, residual: Residual) -> Residual:
        """Return another residual with the samples and in the units of the one in which the law was found.

        Parameters
        ----------
        residual : Residual
            Of the same recording.
        """
        return residual.taking(self.residual.live).scaled(self.residual.noise**-0.5)


def predictive_laws(residual: Residual, whole: float, most: int) -> tuple[list[Found], Residual]:
    """Return the laws that predict samples from others, the strongest first, and the residual without them.

    Parameters
    ----------
    residual : Residual
        Of the samples that count.
    whole : float
        Energy of the gap, of which the laws have their shares.
    most : int
        Number of laws at which the search ends.
    """
    start, found = residual, list[Found]()
    again = repeats(residual.pose) or near_repeats(residual)
    while len(found) < most and not (found and residual.excess < 2 * np.sqrt(2.0 * residual.size)):
        error = TOLERANCE**2 * max(residual.excess, 0.0) / residual.size
        scaled = residual.scaled(float(np.sqrt(max(1 + error, residual.white))))
        least = LEAST_SHARE * max(whole, residual.excess, 1.0) if found else 0.0
        new = [one for one in _strongest(scaled, again) if one.predicted >= least]
        if not new:
            break
        beside = [*found, *(replace(one, shared=one.best) for one in new)]
        found = _beside_each_other(start, beside) if len(beside) > 1 else new
        residual = start.without(_sum_of(found, start))
    return found, residual


def _beside_each_other(residual: Residual, laws: list[Found]) -> list[Found]:
    """Return laws each fitted to what the others leave of a residual, in the sensors in which it then is."""
    for _ in range(2):
        for number, one in enumerate(laws):
            rest = residual.without(_sum_of([*laws[:number], *laws[number + 1 :]], residual))
            beside = _as_found(one.best, [*one.others], rest.scaled(one.residual.noise**-0.5))
            laws[number] = replace(beside, is_of_two=one.is_of_two)
    return laws


def _sum_of(laws: list[Found], residual: Residual) -> FloatArray:
    """Return what laws add to the channels (N, C)."""
    return np.asarray(np.sum([one.signal(residual, one.residual) for one in laws], axis=0))


def _strongest(residual: Residual, again: Repeats | None) -> list[Found]:
    """Return the strongest law of a residual, or two that explain more together; none where none predicts."""
    every = candidates(residual)
    every = sorted([*every, *_refined(residual, every)], key=lambda one: -one.evidence)
    every = _of_sensors(residual, every) if _is_gradient(every[0]) else every
    tried = _in_question(residual, every, again)
    accepted = next(_accepted(residual, tried), None)
    if accepted is None:
        return []
    best, predicted = accepted
    two = _two(residual, every, best, again)
    if two is None:
        return [_as_found(best, tried, residual, predicted)]
    first, second = two
    rest = residual.without(first.signal(residual, residual))
    pair = ((first, residual.without(second.signal(residual, rest))), (second, rest))
    return [replace(_as_found(one, [one], left), is_of_two=True) for one, left in pair]


def _of_sensors(residual: Residual, tried: list[Candidate]) -> list[Candidate]:
    """Return the laws without those of a gradient that changes, if one of the sensors explains more in several."""
    of_sensors = [one for one in tried if not _is_gradient(one)]
    single = next((one for one in of_sensors if len(one.pattern.sensors) == 1), None)
    if single is None or in_its_sensors(residual, single).evidence <= tried[0].evidence:
        return tried
    return of_sensors


def _is_gradient(one: Candidate) -> bool:
    """Say whether a law is a field in the world that is not uniform, and changes with time."""
    return one.pattern.law == "attitude" and one.bins is not None and len(one.pattern.sensors) > 1


def _as_found(best: Candidate, tried: list[Candidate], residual: Residual, predicted: float | None = None) -> Found:
    """Return a law in all sensors in which it is, with the energy that it predicts, if that is not known."""
    shared = in_its_sensors(residual, best)
    if predicted is None or shared is not best:
        predicted = predicted_energy(_halves(residual), shared)
    near = [one for one in tried if one.evidence >= tried[0].evidence - TIE]
    return Found(best, predicted / residual.noise, tuple(near), residual, shared)


def _refined(residual: Residual, tried: list[Candidate]) -> Iterator[Candidate]:
    """Yield courses of the best laws that jump."""
    top = tried[0].evidence
    if top < LEAST_EVIDENCE:
        return
    near = [one for one in tried if one.evidence > 0.7 * top and one.course in ("slow", "random", "step")]
    chosen = list(dict.fromkeys(one.pattern for one in near))[:5]
    gain = next((one.pattern for one in near if one.pattern.law == "gain"), None)
    if gain is not None:
        switched = switched_gains(residual, int(gain.sensors[0]))
        chosen += [one for one in switched if one.axes == gain.axes or len(one.axes) == 3]
    jumps = [jump for pattern in chosen for jump in jumping(residual, pattern)]
    yield from jumps
    two_states = sorted((one for one in jumps if one.begins_on is not None), key=lambda one: -one.evidence)
    for one in two_states[:4]:
        is_coarse = one.evidence > 0.8 * top and one.bins is not None and one.bins.order.shape[1] > 1
        if is_coarse and (fine := sharpened(residual, one)) is not None:
            yield fine


def _in_question(residual: Residual, tried: list[Candidate], again: Repeats | None) -> list[Candidate]:
    """Return the laws that may be accepted, the best first; none that is the same at every pose that is taken up again.

    Those that are simpler than none of the first are left out.
    """
    kept: list[Candidate] = []
    for one in tried:
        if len(kept) >= MOST_TRIED and one.evidence < _least_beside(kept[MOST_TRIED - 1], is_same_law=True):
            break
        if not _is_of_pose(residual, one, again):
            kept.append(one)
    return kept


def _accepted(residual: Residual, tried: list[Candidate]) -> Iterator[tuple[Candidate, float]]:
    """Yield laws that predict, the simplest of those with about the most evidence first, with the energy predicted."""
    leading = [one for one in tried[:MOST_TRIED] if one.evidence >= LEAST_EVIDENCE]
    if not leading:
        return
    halves = _halves(residual)
    for first in leading:
        best = _simplest(first, tried)
        predicted = predicted_energy(halves, best)
        if predicted > LEAST_EVIDENCE:
            yield best, predicted


def _simplest(first: Candidate, tried: list[Candidate]) -> Candidate:
    """Return the simplest of the laws that have about the evidence of one."""
    simpler = [one for one in tried if one is first or _is_as_good_and_simpler(one, first)]
    return _of_fewest_axes(min(simpler, key=lambda one: (_freedom(one), -one.evidence)), tried)


def _two(
    residual: Residual, tried: list[Candidate], free: Candidate, again: Repeats | None
) -> tuple[Candidate, Candidate] | None:
    """Return two laws, the first of which has more evidence beside the second than one with a free course; else None.

    A free course, of a gain above all, imitates the sum of two laws of a sensor.

    Parameters
    ----------
    residual : Residual
    tried : list of Candidate
        The best first.
    free : Candidate
        The law that may be the sum of two.
    again : Repeats, optional
    """
    if free.course not in ("slow", "random"):
        return None
    # The stronger of two has about half of their evidence at least.
    simple = (one for one in tried if _is_simple(one) and one.evidence > (MOST - MINOR) * free.evidence)
    strongest: dict[str, Candidate] = {}
    for one in simple:
        if one.pattern.law not in strongest and not _is_of_pose(residual, one, again):
            strongest[one.pattern.law] = one
    for one in list(strongest.values())[:2]:
        second = _beside(residual, one)
        rest = residual.without(second.signal(residual, residual.without(one.signal(residual, residual))))
        if one.fitted(rest).evidence > free.fitted(rest).evidence + TIE:
            return _beside(residual, second), second
    return None


def _beside(residual: Residual, law: Candidate) -> Candidate:
    """Return the best simple law beside another one."""
    rest = residual.without(law.signal(residual, residual))
    tried = [one for one in candidates(rest, has_free=False) if _is_simple(one)]
    return _simplest(tried[0], tried)


def _is_simple(one: Candidate) -> bool:
    """Say whether a law has constant coefficients, or steps a few times."""
    return one.bins is None or (one.course == "step" and len(one.steps) <= MOST_STEPS)


def _of_fewest_axes(best: Candidate, tried: list[Candidate]) -> Candidate:
    """Return the form of a law with about its evidence that disturbs the fewest axes."""
    forms = [one for one in tried if _form(one) == _form(best) and one.evidence >= best.evidence - TIE]
    return min(forms, key=lambda one: (len(one.pattern.axes), -one.evidence))


def _form(one: Candidate) -> tuple[str, str, Place, str | None]:
    return one.pattern.law, one.course, one.pattern.sensors, one.pattern.follows


def _is_of_pose(residual: Residual, one: Candidate, again: Repeats | None) -> bool:
    """Say whether a course in time is the same at every pose that is taken up again."""
    is_in_time = one.course in ("step", "episodes", "slow", "random", "tone") and one.evidence >= LEAST_EVIDENCE
    return again is not None and is_in_time and again.are_same(one.signal(residual, residual))


def _is_as_good_and_simpler(one: Candidate, first: Candidate) -> bool:
    """Say whether a law has less freedom than the first one and about its evidence.

    Models are wrong by more where the gap is large. A simpler course of the same law may be farther behind: a switch
    takes its time, a channel is recorded with errors.
    """
    same = (one.pattern.law, one.pattern.sensors) == (first.pattern.law, first.pattern.sensors)
    is_simpler = _freedom(one) <= _freedom(first) - 1
    return _least_beside(first, same) <= one.evidence <= first.evidence and is_simpler


def _least_beside(first: Candidate, is_same_law: bool) -> float:
    """Return the evidence of a simpler law that is about that of the first one."""
    return (1 - (0.03 if is_same_law else 0.005)) * first.evidence - TIE


def _freedom(one: Candidate) -> float:
    # Three steps or more imitate a slow course; two in neighbouring bins are one.
    is_staircase = one.course == "step" and (np.diff(one.steps) > 1).sum() > 1
    course = "slow" if is_staircase else one.course
    return FREEDOM[course] + FREEDOM[one.pattern.law] + (len(one.pattern.sensors) > 1)


def _halves(residual: Residual) -> tuple[Residual, Residual]:
    """Return each half of the samples.

    Most neighbours are in different halves, but not at a regular pace, at which a tone would look constant.
    """
    chosen = np.arange(residual.count) * (np.sqrt(5) - 1) / 2 % 1 < 0.5
    return residual.taking(chosen), residual.taking(~chosen)


def predicted_energy(halves: tuple[Residual, Residual], law: Candidate) -> float:
    """Return the energy of each half of the samples that a law fitted to the other half predicts."""
    fallen = 0.0
    for training, rest in (halves, halves[::-1]):
        signal = rest.clear(law.signal(rest, training))
        fallen += float((rest.z**2).sum() - ((rest.z - signal) ** 2).sum())
    return max(fallen, 0.0)


def curve_of(law: Candidate, residual: Residual) -> Course:
    """Return the course of a law that was found in a residual.

    The size is that of the shift of the readings along the direction in which it is largest; for a gain, of the
    coefficients, as a part of the field. A course in time has the errors of its process; that of a law with constant
    coefficients has the relative error 1/√(2 L) of their size, with L its log evidence.
    """
    fit = law.fitted(residual, with_errors=True)
    size = law.pattern.size(residual)
    in_time = law.bins is not None and law.pattern.law != "own_field" and law.course != "tone"
    mean = law.coefficients(fit.mean, residual.count)
    if not in_time:
        mean = np.einsum("nrp,np->nr", law.pattern.features, mean)
    is_gain = in_time and law.pattern.law == "gain"
    unit = residual.unit_T / size / (residual.field_T if is_gain else 1.0)
    direction = np.linalg.svd(mean - mean.mean(axis=0), full_matrices=False)[2][0]
    direction = direction * np.sign(direction[np.abs(direction).argmax()])
    along = mean @ direction * unit
    relative = np.abs(along).max() / np.sqrt(2 * law.evidence)
    error = np.full(len(along), relative)
    if in_time and fit.deviation is not None:
        error = np.sqrt(law.coefficients(fit.deviation, residual.count) ** 2 @ direction**2) * unit
    taken = np.unique(np.linspace(0, len(along) - 1, 200).round().astype(int))
    return Course(residual.time_s[taken], along[taken], error[taken], "1" if is_gain else "T")
