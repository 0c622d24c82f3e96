"""Leaves single bad readings out before a fit: those that contradict the other readings of their samples.

A fit of all samples shows whether there are any. If so, a robust fit finds them, and fits of the other samples repeat
the judgement until it stays the same. Any part of the samples below a third may be bad.
"""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm
from numpy.typing import NDArray

from tam_calibration.core.least_squares import MOST_STEPS
from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.streaming import left_out
from tam_calibration.fit.maximum_likelihood import estimate, maximum_likelihood
from tam_calibration.integrity import require_sound
from tam_calibration.integrity.fault import Fault
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import MOST_NAMED, InputError, Refused, first_at
from tam_calibration.model.recording import SKETCH, Block, Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, IntArray

_STRETCH = 0.1
"""Length of an event, as a part of the recording: if more than half of such a stretch is bad, a magnet came near.

The checks of the fit report an event. A single sensor that fails for as long is left out.
"""


_COMPARED = 3
"""Sensors from which each is compared with the mean of the others; fewer are compared with the intensity."""


_MEDIANS = {1: 0.45494, 3: 2.36597}
"""Of χ² by its degrees of freedom: SciPy, which has them, takes as long to load as a calibration."""


@dataclass(frozen=True, eq=False)
class LeftOut:
    """The samples that are left out, each with the sensor that contradicts the others most.

    Parameters
    ----------
    time_s : (n,) array
        Their times since the first sample.
    place : (n,) array of int
        Their places in the recording.
    sensor : (n,) array of int
        Number of the sensor, from 0; K is the scalar.
    sample_count : int
        Number of samples N of the recording.
    sensor_count : int
        Number of sensors K.
    """

    time_s: FloatArray
    place: IntArray
    sensor: IntArray
    sample_count: int
    sensor_count: int

    @property
    def is_event(self) -> bool:
        """Whether most samples of a stretch of time are left out, and not by one sensor that fails alone."""
        own = self._densest
        # Least part of the bad samples that belong to a sensor that fails alone; noise attributes a few to others.
        fails_alone = _COMPARED <= self.sensor_count != own[0] and bool((own == own[0]).mean() > 0.9)
        return not self.is_brief and not fails_alone

    @property
    def is_brief(self) -> bool:
        """Whether no stretch of time lacks most of its samples."""
        return len(self._densest) <= int(_STRETCH * self.sample_count) / 2

    @cached_property
    def _densest(self) -> IntArray:
        """The sensors of those left out in the stretch that lacks most samples."""
        counts = np.searchsorted(self.place, self.place + int(_STRETCH * self.sample_count))
        counts -= np.arange(len(self.place))
        begin = int(counts.argmax())
        return self.sensor[begin : begin + counts[begin]]

    @property
    def is_lasting(self) -> bool:
        """Whether nearly all samples from the beginning, or until the end, are left out, and no others."""
        first, last = int(self.place[0]), int(self.place[-1])
        reaches_end = first == 0 or last == self.sample_count - 1
        # Least part of the samples of a time that are left out where a sensor changed: some are by chance what
        # they were.
        return reaches_end and len(self.place) > 0.9 * (last + 1 - first)

    def sentences(self) -> Iterator[str]:
        """Yield one sentence for each sensor, the worst first."""
        counts = np.bincount(self.sensor, minlength=self.sensor_count + 1)
        for sensor in np.argsort(-counts, kind="stable").tolist():
            if counts[sensor]:
                own = self.sensor == sensor
                whose = "the scalar" if sensor == self.sensor_count else f"sensor {sensor + 1}"
                when = _when(self.place[own], self.time_s[own])
                yield left_out(counts[sensor], self.sample_count, whose, when)


def _when(place: IntArray, time_s: FloatArray) -> str:
    """Return when some readings were made: between two times, every so many, or the first times."""
    steps = np.unique(np.diff(place))
    if len(place) > MOST_NAMED and len(steps) == 1:
        span = f"between {time_s[0]:.2f} and {time_s[-1]:.2f} s"
        return f"all {span}" if steps[0] == 1 else f"every {_ordinal(int(steps[0]))} {span}"
    return first_at(time_s.tolist())


def _ordinal(number: int) -> str:
    is_teen = number % 100 in (11, 12, 13)
    return f"{number}{'th' if is_teen else {1: 'st', 2: 'nd', 3: 'rd'}.get(number % 10, 'th')}"


def without_bad_readings(recording: SampleSource, array: Array) -> tuple[SampleSource, LeftOut | None]:
    """Return the samples without single bad readings, and what was left out; all samples where nothing is clear.

    Parameters
    ----------
    recording : SampleSource
        Raw readings in a uniform field.
    array : Array
        Geometry and noise of the sensors; a noise that is not stated is estimated.
    """
    # Fewest samples that are judged: their median χ² errs by a sixth with 3 degrees of freedom, and by a third with
    # 1.
    if recording.sample_count < 50:
        return recording, None
    try:
        judge = _Judge(estimate, recording, array)
        # Mean square of the residuals, over the noise or their median, from which bad readings may hide in the fit
        # of all.
        if judge.spread < 2.0 and not judge.is_bad(recording).any():
            return recording, None
    except (InputError, Refused):
        pass  # bad readings may be the reason
    is_far = _far_off(recording)
    # Part of the samples above which no clear majority tells which readings are bad.
    most = 1 / 3
    if is_far.mean() >= most:
        return recording, None
    try:
        judge = _Judge(_robust_estimate, recording.take(~is_far), array)
        is_bad = judge.is_bad(recording)
        for _ in range(MOST_STEPS):
            if not 0 < is_bad.mean() < most:
                return recording, None
            judge = _Judge(estimate, recording.take(~is_bad), array)
            before, is_bad = is_bad, judge.is_bad(recording)
            if (is_bad == before).all():
                break
    except (InputError, Refused):
        return recording, None
    if not 0 < is_bad.mean() < most:
        return recording, None
    bad = recording.take(is_bad).whole()
    since_s = bad.time_s - recording.time_span_s[0]
    found = LeftOut(since_s, np.flatnonzero(is_bad), judge.worst(bad), len(is_bad), recording.sensor_count)
    return (recording, None) if found.is_event else (recording.take(~is_bad), found)


def sound_readings(
    recording: SampleSource, array: Array, accept: Collection[str] = (), sought: Collection[str] = ()
) -> tuple[SampleSource, LeftOut | None, list[Fault]]:
    """Return samples of sound channels as ``without_bad_readings`` does, and the faults that refuse nothing.

    Parameters
    ----------
    recording, array
        As of ``without_bad_readings``.
    accept, sought
        As of ``require_sound``.

    Raises
    ------
    InputError, Refused
        As ``require_sound``.
    """
    used, left_out = without_bad_readings(recording, array)
    screened = used if left_out is not None and left_out.is_brief else None
    return used, left_out, require_sound(recording, array, accept, sought=sought, screened=screened)


def _robust_estimate(recording: SampleSource, array: Array) -> SensorErrors:
    return maximum_likelihood(recording, array, robust=True).errors


def _far_off(recording: SampleSource) -> NDArray[np.bool_]:
    """Return which samples (N,) hold a reading so far from most of its sensor that no fit would begin well."""
    some_T = recording.thinned(SKETCH).readings_T
    center_T = np.median(some_T, axis=0)
    usual_T = np.median([norm(some_T - center_T, axis=2), norm(some_T, axis=2)], axis=1).max(axis=0)
    # Distance from the median reading, over its median or over the field: a turned sensor reaches 2.
    far = [(norm(block.readings_T - center_T, axis=2) > 2.2 * usual_T).any(axis=1) for block in recording.blocks()]
    return np.concatenate(far)


class _Judge:
    """Judges samples by the errors of the sensors.

    Parameters
    ----------
    fit : callable
        From samples and an array with every noise to the errors.
    source : SampleSource
        Samples; some of them make the errors, and show the size of usual residuals.
    array : Array
        Where it states the noise, residuals that are smaller are no reason to judge more strictly.
    """

    def __init__(
        self, fit: Callable[[SampleSource, KnownNoiseArray], SensorErrors], source: SampleSource, array: Array
    ) -> None:
        noisy, some = complete_noise(array, source)[0], source.thinned(SKETCH)
        errors = fit(some, noisy)
        count = errors.sensor_count
        self._is_compared = count >= _COMPARED
        self._has_scalar = some.scalar_T is not None  # else it is slower than these samples, and not judged
        self._intensity_T = float(np.median(norm(errors.restore(some.readings_T).mean(axis=1), axis=1)))
        unmix = errors.joint_inverse.reshape(count, 3, -1)
        mean = unmix.mean(axis=0)
        if self._is_compared:
            unmix = (unmix - mean) * (count / (count - 1))  # less the mean of the others
        self._map = np.concatenate([*unmix, mean])
        self._offset = -self._map @ errors.bias_T.reshape(-1, 1)
        own_T2, scalar_T2 = noisy.vector_noise_T**2, noisy.scalar_noise_T**2
        of_others = (own_T2.sum() - own_T2) / (count - 1) ** 2 if self._is_compared else scalar_T2
        self._variance_T2 = np.append(own_T2 + of_others, own_T2.sum() / count**2 + scalar_T2)[:, None]
        freedom = np.append(np.full(count, 3 if self._is_compared else 1), 1)
        distances = self._distances(some)
        scale = np.nanmedian(distances, axis=1) / [_MEDIANS[each] for each in freedom]
        # Distances are zero where an axis is constant.
        least = np.clip(scale, np.finfo(float).tiny, 1)
        self.spread = float(np.max(np.nanmean(distances, axis=1) / freedom / least))
        # Probability that a sound recording loses a sample.
        exponent = np.log(distances.size / 1e-3)
        # No χ² is larger with probability exp(-exponent), Laurent and Massart 2000, lemma 1.
        limits = freedom + 2 * np.sqrt(freedom * exponent) + 2 * exponent
        # Median square of the residuals over that of an estimated noise: below lies only rounding.
        self._limits = (limits * np.maximum(scale, 1e-2 if array.vector_noise_T is None else 1.0))[:, None]

    def is_bad(self, source: SampleSource) -> NDArray[np.bool_]:
        """Return which samples (N,) hold a reading that contradicts the others."""
        # No distance (NaN) is beyond a limit.
        return np.concatenate([(self._distances(block) > self._limits).any(axis=0) for block in source.blocks()])

    def worst(self, samples: Recording) -> IntArray:
        """Return the sensor (N,), or K for the scalar, that contradicts the others most.

        Of those beyond their limits it is the farthest off: a bad reading moves the mean that all others are held to.
        """
        distances = np.nan_to_num(self._distances(samples))
        return np.asarray((distances * (distances > self._limits)).argmax(axis=0), dtype=np.int64)

    def _distances(self, samples: Block | Recording) -> FloatArray:
        """Return each sensor's and the scalar's squared distances (K + 1, N) from the others, over their variance."""
        readings_T = samples.readings_T
        vectors_T = self._map @ readings_T.reshape(len(readings_T), -1).T + self._offset
        squares_T2 = (vectors_T**2).reshape(-1, 3, len(readings_T)).sum(axis=1)
        scalar_T = samples.scalar_T if self._has_scalar and samples.scalar_T is not None else self._intensity_T
        of_intensity = slice(-1 if self._is_compared else 0, None)
        squares_T2[of_intensity] = (np.sqrt(squares_T2[of_intensity]) - scalar_T) ** 2
        return np.asarray(squares_T2 / self._variance_T2)
