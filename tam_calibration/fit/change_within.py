"""The time within a recording at which one calibration ends and another begins, found without fitting either.

In a uniform field the readings of all sensors lie in one affine space of three dimensions, and those of each sensor on
one ellipsoid. How far they leave both follows from sums over the samples. Sums of a part are differences of cumulative
sums, so that every pair of times is tried. A change improves the likelihood of the readings inside and outside.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import complete_noise
from tam_calibration.fit.ellipsoid import normalize
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import FEWEST_SAMPLES, Recording, SampleSource
from tam_calibration.model.units import FloatArray

_CHANCE = 1e-6
"""Probability that chance gains as much at given times, of which thousands are tried."""


@dataclass(frozen=True)
class Span:
    """The samples from ``first`` until before ``last`` that differ from the others, of a thinned recording.

    Parameters
    ----------
    some : Recording
        The thinned recording of N samples.
    array : KnownNoiseArray
        With the noise that is left in short stretches where it is not stated.
    first, last : int
        ``last`` is N where the change lasts until the end.
    inside_is_steady, outside_is_steady : bool
        Whether no further change is in these samples, and in the others: one of both at least, and both where it ends.
    is_plain : bool
        Whether it is so large that no slow noise looks like it.
    """

    some: Recording
    array: KnownNoiseArray
    first: int
    last: int
    inside_is_steady: bool
    outside_is_steady: bool
    is_plain: bool

    def of_all(self, is_some: NDArray[np.bool_], count: int) -> NDArray[np.bool_]:
        """Return which of all (N,) samples are those of a part of the thinned ones."""
        stride = -(-count // self.some.sample_count)
        return np.repeat(is_some, stride)[:count]

    @property
    def is_inside(self) -> NDArray[np.bool_]:
        """Which samples (N,) differ."""
        place = np.arange(self.some.sample_count)
        return (place >= self.first) & (place < self.last)


def find_change(recording: SampleSource, array: Array) -> Span | None:
    """Return the span of samples that differ from the others, the span until the end before any other; None without.

    Slow drifts are no change: in both parts a further change explains nearly as much as the first.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Of these sensors; a noise that is not stated is estimated.
    """
    channels = 3 * array.sensor_count + 1
    # 400_000: products that are summed for each sample, times the samples: 3 MB of cumulative sums. More samples are
    # thinned.
    some = recording.thinned(max(30 * FEWEST_SAMPLES, 400_000 // (channels**2 + 11 * channels)))
    count = some.sample_count
    if count < 6 * FEWEST_SAMPLES:
        return None
    noisy, _ = complete_noise(array, some)
    sums = _Sums.of(some, noisy)
    if array.vector_noise_T is None:
        noisy = array.with_noise(noisy.vector_noise_T * np.sqrt(sums.usual_variance()), noisy.scalar_noise_T)
        sums = _Sums.of(some, noisy)
    # 60 and 12: blocks of time at whose ends a change is searched first, with up to four sensors and with many.
    blocks = max(12, int(60 * min(1.0, (4 / array.sensor_count) ** 1.5)))
    bounds = np.unique(np.linspace(0, count, min(blocks, count // 10) + 1).astype(int))
    first, last = (index.ravel() for index in np.meshgrid(bounds[1:-1], bounds[1:], indexing="ij"))
    best, gain = sums.best(np.column_stack([first, last]), 0, count)
    reach = int(np.diff(bounds).max())
    steps = np.unique(np.linspace(-reach, reach, 2 * blocks).astype(int))
    # Rounds of refining either end of a change to the sample, the other end held.
    for _ in range(2):
        for end in (0, 1):
            if best[end] < count:
                moved = np.where(np.arange(2) == end, best[end] + steps[:, None], best)
                best, gain = sums.best(moved, 0, count)
    # No χ² exceeds its freedom by more, but with that probability: Laurent and Massart 2000, lemma 1.
    chance = 2 * np.sqrt(-np.log(_CHANCE) * sums.parameters) - 2 * np.log(_CHANCE)
    if gain < chance:
        return None
    edges = np.unique([0, *best, count])
    further = [
        sums.best(np.column_stack([bounds, np.full_like(bounds, stop)]), start, stop)[1]
        for start, stop in pairwise(edges)
    ]
    # Largest gain of a further change that is no chance, as a part of the first: of a ramp it is a half.
    # The same of one that chance may have made: slow noise of short recordings looks like steps too.
    is_steady = np.array(further) <= max(0.05 * gain, min(chance, 0.2 * gain))
    if not (is_steady.any() if best[1] == count else is_steady.all()):
        return None
    # Gain for each parameter from which a change is plain: a step of five times the noise in one axis half-way of
    # 1200 samples. Slow noise of five times the white one gained less in 300 recordings.
    return Span(
        some,
        noisy,
        int(best[0]),
        int(best[1]),
        bool(is_steady[1]),
        bool(is_steady[::2].all()),
        gain > 50.0 * sums.parameters,
    )


@dataclass(frozen=True, eq=False)
class _Sums:
    """Sums over the samples before each, of products of all channels and of the terms of each sensor's ellipsoid.

    Parameters
    ----------
    joint : (N + 1, 3 K + 1, 3 K + 1) array
        Of the readings over their noise, and 1.
    quartic : (N + 1, K, P + 1, P + 1) array
        Of the P terms and the square of the reading, which these explain, over its noise.
    """

    joint: FloatArray
    quartic: FloatArray

    @classmethod
    def of(cls, recording: Recording, array: KnownNoiseArray) -> "_Sums":
        """Return the sums of a recording."""
        data = normalize(recording)
        noise = array.vector_noise_T / data.radius_T
        points = data.points
        x, y, z = np.moveaxis(points, 2, 0)
        one, square = np.ones_like(x), x * x + y * y + z * z
        terms = [x * x - y * y, square - 3 * z * z, x * y, x * z, y * z, x, y, z, one]
        if recording.scalar_T is not None:
            varying = steady_intensity(recording) ** 2
            terms.append(one * (varying - varying.mean())[:, None] / max(float(varying.std()), 1e-30))
        quartic = np.stack([*terms, square], axis=2) / (2 * noise[:, None])
        joint = np.concatenate([(points / noise[:, None]).reshape(len(points), -1), one[:, :1]], axis=1)
        return cls(_cumulative(joint), _cumulative(quartic))

    @property
    def parameters(self) -> int:
        """Number of parameters of one part."""
        channels, terms = self.joint.shape[1] - 1, self.quartic.shape[2] - 1
        return int(4 * (channels - 3) + self.quartic.shape[1] * terms)

    def best(self, spans: NDArray[np.intp], start: int, stop: int) -> tuple[NDArray[np.intp], float]:
        """Return the best of some spans (S, 2) against the other samples, and its gain; 0 where none is possible.

        Parameters
        ----------
        spans : (S, 2) array
            First and last sample of each.
        start, stop : int
            First of all samples that count, and the end of them.
        """
        whole = len(self.joint) - 1
        inside = spans[:, 1] - spans[:, 0]
        outside = stop - start - inside
        # Of each part three times the samples through which any ellipsoid passes.
        is_long = np.minimum(inside, outside) >= 3 * FEWEST_SAMPLES
        is_possible = (spans[:, 0] > start) & is_long & (spans[:, 1] <= stop)
        spans = spans[is_possible]
        if not len(spans):
            return np.array([whole, whole]), 0.0
        ends = np.array([[start, stop]])
        gain = self._deviance(ends, None) - self._deviance(spans, None) - self._deviance(ends, spans)
        # The change that lasts is preferred to one that ends by so little that chance decides.
        best = int(np.argmax(gain + (spans[:, 1] == whole) * self.parameters))
        return spans[best], float(gain[best])

    def _deviance(self, spans: NDArray[np.intp], without: NDArray[np.intp] | None) -> FloatArray:
        """Return -2 log likelihood (S,) of one calibration of the samples of spans, without those of others in them."""
        joint, quartic = (each[spans[:, 1]] - each[spans[:, 0]] for each in (self.joint, self.quartic))
        if without is not None:
            joint = joint - (self.joint[without[:, 1]] - self.joint[without[:, 0]])
            quartic = quartic - (self.quartic[without[:, 1]] - self.quartic[without[:, 0]])
        between, own = _energies(joint, quartic)
        # Short arcs lie on ellipsoids so flat that noise hardly leaves them.
        energy = between + np.sum(np.maximum(own, joint[:, -1, -1, None]), axis=1)
        channels = joint.shape[1] - 1
        freedom = joint[:, -1, -1] * (channels - 3 + channels // 3)
        # Least variance of the residuals over that of the noise; what is below is rounding.
        return np.asarray(freedom * np.log(energy / (freedom - self.parameters) + 1e-3))

    def usual_variance(self) -> float:
        """Return the median variance over the noise that short stretches leave between sensors, or of a single one."""
        # Samples of the stretches in which a noise that is not stated is looked for: a change is in one of them.
        bounds = np.linspace(0, len(self.joint) - 1, (len(self.joint) - 1) // 60 + 1).astype(int)
        between, own = _energies(np.diff(self.joint[bounds], axis=0), np.diff(self.quartic[bounds], axis=0))
        channels, terms = self.joint.shape[1] - 1, self.quartic.shape[2] - 1
        if channels == 3:
            return float(np.median(own[:, 0] / (np.diff(bounds) - terms)))
        return float(np.median(between / ((channels - 3) * (np.diff(bounds) - 4))))


def _energies(joint: FloatArray, quartic: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the energies (S,) beyond three components of all channels, and (S, K) off each sensor's ellipsoid."""
    mean = joint[:, :-1, -1:] / joint[:, -1:, -1:]
    spread = joint[:, :-1, :-1] - mean * joint[:, -1:, :-1]
    normal, right = quartic[..., :-1, :-1], quartic[..., :-1, -1]
    # Part of the trace of normal equations below which lies the rounding of cumulative sums.
    ridge = 1e-13 * np.trace(normal, axis1=-2, axis2=-1)[..., None, None] * np.eye(normal.shape[-1])
    explained = np.sum(right * np.linalg.solve(normal + ridge, right[..., None])[..., 0], axis=-1)
    between = np.sum(np.maximum(np.linalg.eigvalsh(spread)[:, :-3], 0), axis=1)
    return between, np.maximum(quartic[..., -1, -1] - explained, 0)


def _cumulative(values: FloatArray) -> FloatArray:
    """Return the sums (N + 1, ..., P, P) of the outer products of values (N, ..., P) over the samples before each."""
    total = np.zeros((len(values) + 1, *values.shape[1:], values.shape[-1]))
    np.cumsum(values[..., :, None] * values[..., None, :], axis=0, out=total[1:])
    return total


def steady_intensity(recording: Recording) -> FloatArray:
    """Return the readings (N,) of the scalar magnetometer, those that are missing interpolated, tesla."""
    assert recording.scalar_T is not None
    known = np.isfinite(recording.scalar_T)
    return np.interp(recording.time_s, recording.time_s[known], recording.scalar_T[known])
