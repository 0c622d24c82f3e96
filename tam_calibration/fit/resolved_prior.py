"""What a recording contradicts its prior in: what moved, since when, and the prior without it.

Where something moved within the recording, the samples before it are fitted first, and what they tell with the prior is
the prior of those after it: what did not move is known from all samples.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.correction.update import KINDS, Moved
from tam_calibration.fit.change_time import samples_between, time_of_change
from tam_calibration.fit.contradiction import (
    MOST_CHANGES,
    Change,
    Difference,
    candidates_of,
    changes_that_explain,
    estimated_beside,
    is_everything,
)
from tam_calibration.fit.large_change import large_change
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, with_noise
from tam_calibration.fit.posterior import Known, Posterior, posterior_of
from tam_calibration.fit.prior import Prior
from tam_calibration.fit.sensor_changes import FAR_RATIO
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import Recording, SampleSource

MOST_TIMES = 3
"""That something moves within a recording: a tool is picked up, used and dropped."""

_MOST_TRIES = 5
"""To place a change within a recording, each with the errors before and after the last: two or three are enough."""

_PART_UNSURE = 50
"""A fiftieth of the recording to both sides of the first estimate of a change: what it may be wrong by, or last for."""

_Found = Sequence[Sequence[Change]]
"""Changes, each with its plausible rivals after it."""


@dataclass(frozen=True, eq=False)
class Resolved:
    """A prior and the recording that it is used with, in no contradiction.

    Parameters
    ----------
    recording : SampleSource
        The samples of the array as it is now: those after the last change that the recording shows.
    known : Known
        What is known beside them: the prior, with what the samples before a change tell, widened where something moved.
    difference : Difference, optional
        Of the data and the prior as given; None without a prior.
    found : sequence of sequence of Change
        What was found to have moved, each change with its plausible rivals.
    moved : tuple of Moved
        The same, for people.
    earlier : tuple of (Recording, Known)
        The samples between changes that the recording shows, and what is known beside them.
    refusal : Refused, optional
        Why the samples after a change make no calibration; what moved is then not known.
    """

    recording: SampleSource
    known: Known
    difference: Difference | None = None
    found: _Found = ()
    moved: tuple[Moved, ...] = ()
    earlier: tuple[tuple[Recording, Known], ...] = ()
    refusal: Refused | None = None

    def prior_of(self, given: Prior) -> Prior:
        """Return the prior as given, less certain by all that moved."""
        return _widened(given, self.found)


def resolve(recording: SampleSource, array: Array, known: Known, most_times: int = 1) -> Resolved:
    """Find what a recording contradicts a prior in, and widen the prior there.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    known : Known
        What is known beside it; without a prior there is nothing to contradict.
    most_times : int
        How often something may have moved within the recording.

    Raises
    ------
    Refused
        When the iteration does not settle.
    """
    if known.prior is None:
        return Resolved(recording, known)
    noisy, posterior, _ = with_noise(recording, array, known)
    difference, found = _contradiction(recording, noisy, known)
    if not found:
        return Resolved(recording, known, difference)
    beside = replace(known, prior=_widened(known.prior, found))
    resolved = Resolved(recording, beside, None, found, _moved(found, None))
    parts: list[Recording] = []
    while resolved.refusal is None and len(parts) <= most_times:
        # What the first change was told as, another after it may have bent: all parts are gone through again.
        before = resolved.known if parts else known
        split = _split(resolved.recording.whole(), noisy, before, posterior, resolved.found[0][0])
        if split is None:
            break
        parts = [*parts[:-1], *split]
        further = _in_sequence(parts, noisy, known)
        if further is None or (further.refusal is not None and resolved.earlier):
            break
        resolved = further
        if resolved.refusal is None:
            posterior = posterior_of(resolved.recording, noisy, resolved.known)
    return replace(resolved, difference=difference)


def _in_sequence(parts: Sequence[Recording], array: KnownNoiseArray, known: Known) -> Resolved | None:
    """Return the last of some parts of a recording beside those before it; None where nothing moved before that."""
    earlier: list[tuple[Recording, Known]] = []
    all_found: list[Sequence[Change]] = []
    moved: tuple[Moved, ...] = ()
    for part in parts:
        try:
            _, found = _contradiction(part, array, known)
            if part is parts[-1] and not found:
                return None
            assert known.prior is not None
            known = replace(known, prior=_widened(known.prior, found))
            if part is not parts[-1]:
                earlier.append((part, known))
                known = _known_after(part, array, known)
        except Refused as refusal:
            if not earlier:
                raise
            return Resolved(part, known, earlier=tuple(earlier), refusal=refusal)
        all_found += found
        moved += _moved(found, float(part.time_s[0]) if part is not parts[0] else None)
    return Resolved(parts[-1], known, None, all_found, moved, tuple(earlier))


def _contradiction(
    recording: SampleSource, array: KnownNoiseArray, known: Known, most: int = MOST_CHANGES
) -> tuple[Difference, _Found]:
    """Return the difference of readings and prior, and the changes that explain it: large ones, then what is left."""
    large: list[Sequence[Change]] = []
    prior = known.prior
    assert prior is not None
    candidates = candidates_of(prior, recording.scalar_count is not None or known.main_field_T is not None)
    left = difference = Difference.of(prior, posterior_of(recording, array, known))
    with suppress(Refused):
        while left.chi_square > FAR_RATIO and len(large) < most:
            strongest = large_change(recording, array, replace(known, prior=prior), candidates)
            if not strongest:
                break
            used = _widened(prior, [strongest])
            posterior = posterior_of(recording, array, replace(known, prior=used))
            large.append([estimated_beside(strongest[0], prior, posterior), *strongest[1:]])
            if is_everything(strongest[0]):
                return difference, large
            prior, left = used, Difference.of(used, posterior)
    found = changes_that_explain(left, candidates)
    if any(is_everything(change) for change, *_ in found):
        try:
            posterior_of(recording, array, replace(known, prior=_widened(prior, found)))
        except Refused:
            found = changes_that_explain(left, [sizes for sizes in candidates if not is_everything(sizes[0])])
    return difference, [*large, *found][:most]


def _split(
    whole: Recording, array: KnownNoiseArray, known: Known, posterior: Posterior, change: Change
) -> tuple[Recording, Recording] | None:
    """Return the samples before and after a change, by the errors that they have; those during it are in neither.

    None where they tell of no change within the recording.
    """
    since_s = time_of_change(whole, array, known, posterior, change)
    prior, count = known.prior, whole.sample_count
    if since_s is None or prior is None:
        return None
    place = int(np.searchsorted(whole.time_s, since_s))
    margin = min(count // _PART_UNSURE, place // 2, (count - place) // 2)
    last, first = place - margin, place + margin
    with suppress(Refused):
        for _ in range(_MOST_TRIES):
            later = whole.take(slice(first, None))
            before = posterior_of(whole.take(slice(last)), array, known)
            strongest = _contradiction(later, array, known, most=1)[1]
            after = posterior_of(later, array, replace(known, prior=_widened(prior, strongest)))
            tried = last, first
            last, first = samples_between(whole, array, known.variance_factors, before, after)
            if (last, first) == tried:
                break
    return whole.take(slice(last)), whole.take(slice(first, None))


def _known_after(earlier: Recording, array: KnownNoiseArray, known: Known) -> Known:
    """Return what is known beside samples that follow others: what these tell too, where nothing counts twice for it.

    The errors of a main field, and of how attitude is mounted, are the same in both.
    """
    prior = known.prior
    assert prior is not None
    if known.main_field_T is not None or array.mounting_error is not None:
        return known
    before = maximum_a_posteriori(earlier, array, known)
    assert before.covariance is not None
    return replace(known, prior=replace(prior, calibration=before, covariance=before.covariance))


def _widened(prior: Prior, found: _Found) -> Prior:
    """Return the prior less certain by all plausible changes."""
    for change in (change for plausible in found for change in plausible):
        prior = prior.widened(change.directions, change.variance)
    return prior


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
            part, told = (KINDS[place], sensor + 1), (values[sensor, place], errors[sensor, place])
            together = None if part == own else own
            moved.setdefault(part, Moved(*part, *told, change.probability, others, since_s, together))
    return tuple(moved.values())
