"""What a recording contradicts its prior in: what moved, since when, and the prior without it.

Where something moved within the recording, the samples before it are fitted first, and what they tell with the prior is
the prior of those after it: what did not move is known from all samples.

Where a recording shows it, the time of a change is found too. Lengths are no straight lines over a large contradiction:
each change that may explain it is fitted by itself with the prior, its own errors all but free, and they are compared
by the energy that is left and the number of their unknowns (Schwarz 1978).
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import accumulate, pairwise

import numpy as np

from tam_calibration.core.noise import VarianceFactors
from tam_calibration.correction.parts import KINDS, Moved
from tam_calibration.fit import contradiction
from tam_calibration.fit.contradiction import Unnamed, unnamed_changes
from tam_calibration.fit.estimate import sample_energies
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, with_noise
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.problem import Known, Place, Posterior, Problem, posterior_of
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.units import FloatArray


def large_change(
    recording: SampleSource, array: KnownNoiseArray, known: Known, candidates: Sequence[Sequence[contradiction.Change]]
) -> list[contradiction.Change]:
    """Return the most probable change, and after it those that are not improbable either; none where no fit settles.

    Parameters
    ----------
    recording : SampleSource
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    known : Known
        Of which the recording contradicts the prior.
    candidates : sequence of sequence of Change
        What may have changed, each in all sizes.
    """
    prior, some = known.given, recording.whole()
    # Of a recording, spread over it: what contradicts by as much shows in some.
    some = some.take(slice(None, None, -(-some.sample_count // 500)))
    weighed = []
    for *_, largest in candidates:
        used = prior.widened(largest.directions, largest.variance)
        with suppress(Refused):
            problem = Problem.of(some, array, replace(known, prior=used))
            place, _ = problem.settled(problem.start, is_corrected=False)
            left = float(sample_energies(some, array, known.variance_factors, place.errors, place.intensity_T).sum())
            left += used.terms(place.errors).energy + len(largest.variance) * np.log(some.sample_count)
            weighed.append((contradiction.log_odds(largest) - left / 2, largest))
    return contradiction.plausible(weighed) if weighed else []


def time_of_change(
    recording: Recording, array: KnownNoiseArray, known: Known, posterior: Posterior, change: contradiction.Change
) -> float | None:
    """Return the time stamp from which on errors were changed; None where they were so from the start.

    A change from block j on acts with the information of the samples from there on, while the errors before it are
    those of the prior: as in ``contradiction``, the evidences of all j are compared.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    known : Known
        What is known before; the recording contradicts its prior.
    posterior : Posterior
        Of both.
    change : Change
        What moved.
    """
    known = replace(known, gyroscope=None)  # its turns reach from one block into the next
    # Of equal length, at the beginning of one of which the change is placed: to a hundredth of the recording.
    count = min(100, recording.sample_count)
    starts = np.linspace(0, recording.sample_count, count + 1).astype(int)
    place = Place(posterior.errors, posterior.intensity_T, posterior.motion)
    has_scalar = recording.scalar_count is not None
    problems = [Problem.of(recording.take(slice(*span)), array, known, has_scalar) for span in pairwise(starts)]
    parts = [problem.data_at(place) for problem in problems]
    later = list(accumulate(parts[::-1]))[::-1]
    covariance = inverted((later[0] + problems[0].known_at(place)).information, problems[0].basis_at(place))
    size = len(change.directions)
    evidence = [contradiction.Difference.since(rest, covariance, size).evidence(change) for rest in later]
    best = int(np.argmax(evidence))
    # Logarithm of the evidence, in addition to that of the number of times tried, for a change within the
    # recording.
    if evidence[best] - evidence[0] < 5.0 + np.log(count):
        return None
    return float(recording.time_s[starts[best]])


def samples_between(
    recording: Recording, array: KnownNoiseArray, factors: VarianceFactors, before: Posterior, after: Posterior
) -> tuple[int, int]:
    """Return the number of samples that the errors before a change fit, and the place from which on those after it do.

    Of a change of many times the noise, which bends what ``time_of_change`` takes for straight, this is the time. While
    it lasts, as when a tool is picked up, samples fit neither: they lie between the two places.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    array : KnownNoiseArray
        With every noise.
    factors : VarianceFactors
        Of the channels, as of ``Known``.
    before, after : Posterior
        Of the samples before the change and of those after it, or most of them.
    """
    old, new = (sample_energies(recording, array, factors, fit.errors, fit.intensity_T) for fit in (before, after))
    gained = np.cumsum((old - new)[::-1])[::-1]
    last = first = 1 + int(np.argmax(gained[1:]))
    channels = 3 * array.sensor_count - 2
    old_limit, new_limit = _largest(old[:last], channels), _largest(new[first:], channels)
    while last > 1 and old[last - 1] > old_limit:
        last -= 1
    while first < len(new) - 1 and new[first] > new_limit:
        first += 1
    return last, first


def _largest(energies: FloatArray, channels: int) -> float:
    """Return the energy beyond which a sample does not fit, where most do, or do as well as these."""
    from scipy.special import chdtri

    # Probability of a sample's energy beyond which it does not fit: none in most recordings.
    usual, limit = chdtri(channels, [0.5, 1e-6])
    return float(limit * max(1.0, np.median(energies) / usual))


_Found = Sequence[Sequence[contradiction.Change]]
"""Changes, each with its plausible rivals after it."""


@dataclass(frozen=True, eq=False)
class UpdatedPrior:
    """A prior and the recording that it is used with, in no contradiction.

    Parameters
    ----------
    recording : SampleSource
        The samples of the array as it is now: those after the last change that the recording shows.
    known : Known
        What else is known: the prior, with what the samples before a change tell, widened where something moved.
    difference : Difference, optional
        Of the data and the prior as given; None without a prior.
    found : sequence of sequence of Change
        What was found to have moved, each change with its plausible rivals.
    moved : tuple of Moved
        The same, for people.
    earlier : tuple of (Recording, Known)
        The samples between changes that the recording shows, and what else is known.
    refusal : Refused, optional
        Why the samples after a change make no calibration; what moved is then not known.
    unnamed : sequence of Unnamed
        What may have changed in addition, where no change has a time: ``known`` allows for it.
    """

    recording: SampleSource
    known: Known
    difference: contradiction.Difference | None = None
    found: _Found = ()
    moved: tuple[Moved, ...] = ()
    earlier: tuple[tuple[Recording, Known], ...] = ()
    refusal: Refused | None = None
    unnamed: Sequence[Unnamed] = ()

    def prior_of(self, given: Prior) -> Prior:
        """Return the prior as given, less certain by all that moved."""
        return _widened(given, self.found)


def update_prior(recording: SampleSource, array: Array, known: Known, most_times: int = 1) -> UpdatedPrior:
    """Find what a recording contradicts a prior in, and widen the prior there.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    known : Known
        What else is known; without a prior there is nothing to contradict.
    most_times : int
        How often something may have moved within the recording.

    Raises
    ------
    Refused
        When the iteration does not settle.
    """
    if known.prior is None:
        return UpdatedPrior(recording, known)
    noisy, posterior, _ = with_noise(recording, array, known)
    difference, found = _contradiction(recording, noisy, known)
    unnamed = unnamed_changes(difference, known.prior, found, _candidates(recording, known))
    if not found:
        return UpdatedPrior(recording, _allowing_for(unnamed, known), difference, unnamed=unnamed)
    widened = _less_certain(known, found)
    updated = UpdatedPrior(recording, widened, None, found, _moved(found, None))
    parts: list[Recording] = []
    while updated.refusal is None and len(parts) <= most_times:
        # A later change may have bent what the first was found to be: all parts are gone through again.
        before = updated.known if parts else known
        split = _split(updated.recording.whole(), noisy, before, posterior, updated.found[0][0])
        if split is None:
            break
        parts = [*parts[:-1], *split]
        further = _in_sequence(parts, noisy, known)
        if further is None or (further.refusal is not None and updated.earlier):
            break
        updated = further
        if updated.refusal is None:
            posterior = posterior_of(updated.recording, noisy, updated.known)
    if updated.earlier or updated.refusal is not None:
        return replace(updated, difference=difference)
    return replace(updated, known=_allowing_for(unnamed, widened), difference=difference, unnamed=unnamed)


def _in_sequence(parts: Sequence[Recording], array: KnownNoiseArray, known: Known) -> UpdatedPrior | None:
    """Return the last part of a recording, with those before it as prior; None where nothing moved before it."""
    earlier: list[tuple[Recording, Known]] = []
    all_found: list[Sequence[contradiction.Change]] = []
    moved: tuple[Moved, ...] = ()
    for part in parts:
        try:
            _, found = _contradiction(part, array, known)
            if part is parts[-1] and not found:
                return None
            known = _less_certain(known, found)
            if part is not parts[-1]:
                earlier.append((part, known))
                known = _known_after(part, array, known)
        except Refused as refusal:
            if not earlier:
                raise
            return UpdatedPrior(part, known, earlier=tuple(earlier), refusal=refusal)
        all_found += found
        moved += _moved(found, float(part.time_s[0]) if part is not parts[0] else None)
    return UpdatedPrior(parts[-1], known, None, all_found, moved, tuple(earlier))


def _contradiction(
    recording: SampleSource, array: KnownNoiseArray, known: Known, most: int = contradiction.MOST_CHANGES
) -> tuple[contradiction.Difference, _Found]:
    """Return the difference of readings and prior, and the changes that explain it: large ones, then what is left."""
    large: list[Sequence[contradiction.Change]] = []
    candidates = _candidates(recording, known)
    left = difference = contradiction.Difference.of(known.given, posterior_of(recording, array, known))
    with suppress(Refused):
        while left.chi_square > contradiction.FAR_RATIO and len(large) < most:
            strongest = large_change(recording, array, known, candidates)
            if not strongest:
                break
            used = _less_certain(known, [strongest])
            posterior = posterior_of(recording, array, used)
            large.append([contradiction.estimated_with(strongest[0], known.given, posterior), *strongest[1:]])
            if contradiction.is_everything(strongest[0]):
                return difference, large
            known, left = used, contradiction.Difference.of(used.given, posterior)
    found = contradiction.changes_that_explain(left, candidates)
    if any(contradiction.is_everything(change) for change, *_ in found):
        try:
            posterior_of(recording, array, _less_certain(known, found))
        except Refused:
            found = contradiction.changes_that_explain(
                left, [sizes for sizes in candidates if not contradiction.is_everything(sizes[0])]
            )
    return difference, [*large, *found][:most]


def _candidates(recording: SampleSource, known: Known) -> list[list[contradiction.Change]]:
    sees_scale = recording.scalar_count is not None or known.main_field_T is not None
    return contradiction.candidates_of(known.given, sees_scale)


def _split(
    whole: Recording, array: KnownNoiseArray, known: Known, posterior: Posterior, change: contradiction.Change
) -> tuple[Recording, Recording] | None:
    """Return the samples before and after a change, by the errors that they have; those during it are in neither.

    None where they tell of no change within the recording.
    """
    since_s = time_of_change(whole, array, known, posterior, change)
    count = whole.sample_count
    if since_s is None:
        return None
    place = int(np.searchsorted(whole.time_s, since_s))
    # A fiftieth of the recording to both sides of the first estimate of a change: what it may be wrong by, or last
    # for.
    margin = min(count // 50, place // 2, (count - place) // 2)
    last, first = place - margin, place + margin
    with suppress(Refused):
        # To place a change within a recording, each with the errors before and after the last: two or three are
        # enough.
        for _ in range(5):
            later = whole.take(slice(first, None))
            before = posterior_of(whole.take(slice(last)), array, known)
            strongest = _contradiction(later, array, known, most=1)[1]
            after = posterior_of(later, array, _less_certain(known, strongest))
            tried = last, first
            last, first = samples_between(whole, array, known.variance_factors, before, after)
            if (last, first) == tried:
                break
    return whole.take(slice(last)), whole.take(slice(first, None))


def _known_after(earlier: Recording, array: KnownNoiseArray, known: Known) -> Known:
    """Return what else is known of samples that follow others: what these tell too, where nothing counts twice for it.

    The errors of a main field, and of how attitude is mounted, are the same in both.
    """
    if known.main_field_T is not None or array.mounting_error is not None:
        return known
    before = maximum_a_posteriori(earlier, array, known)
    return replace(known, prior=replace(known.given, calibration=before, covariance=before.covariance))


def _widened(prior: Prior, found: _Found) -> Prior:
    """Return the prior less certain by all plausible changes."""
    for change in (change for several in found for change in several):
        prior = prior.widened(change.directions, change.variance)
    return prior


def _less_certain(known: Known, found: _Found) -> Known:
    """Return what is known with a prior that is less certain by all plausible changes."""
    return replace(known, prior=_widened(known.given, found))


def _allowing_for(unnamed: Sequence[Unnamed], known: Known) -> Known:
    """Return what is known with a prior that is less certain by what may have changed and is not named."""
    more = sum((each.covariance for each in unnamed), np.zeros_like(known.given.covariance))
    return replace(known, prior=known.given.with_more(more))


def _moved(found: _Found, since_s: float | None) -> tuple[Moved, ...]:
    """Return changes for people: each kind of each sensor by itself, and once."""
    moved: dict[tuple[str, int], Moved] = {}
    for change, *rivals in found:
        hypothesis = change.hypothesis
        own = hypothesis.parameters, hypothesis.sensor
        others = tuple((rival.hypothesis.parameters, rival.hypothesis.sensor) for rival in rivals)
        values = (hypothesis.directions @ change.estimate).reshape(-1, 4, 3)
        errors = (np.abs(hypothesis.directions) @ change.standard_errors).reshape(-1, 4, 3)
        for sensor, place in np.argwhere(errors.any(axis=2)).tolist():
            part, change_in_si = (KINDS[place], sensor + 1), (values[sensor, place], errors[sensor, place])
            together = None if part == own else own
            moved.setdefault(part, Moved(*part, *change_in_si, change.probability, others, since_s, together))
    return tuple(moved.values())
