"""Readings that are missing although a message or row came: NaN, zeros, sentinels, and what no such sensor reads."""

import math
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tam_calibration.messages.point_cloud import is_channel
from tam_calibration.model.exceptions import MOST_NAMED, InputError, first_at
from tam_calibration.model.recording import FEWEST_SAMPLES
from tam_calibration.model.units import FloatArray

REASONS = (
    *("damaged, not finite or without time", "NaN or blank", "zero on all axes", "sentinels"),
    *("far outside the range of the others", "beyond what any sensor reads"),
)
"""Why a reading is missing, by its code; 0 of those that are there, and of messages that are lost with them."""

_, NAN, ZERO, SENTINEL, FAR, BEYOND = range(len(REASONS))

HUGE = 1e30
"""In any unit: no field is so strong; drivers publish 1e300 for a reading that failed."""

_LEAST_OF_TYPES = tuple(float(np.iinfo(kind).min) for kind in (np.int16, np.int32))
"""The least numbers of 16 and 32 bits, which converters give on one axis when they fail."""

_DUMMIES = (*_LEAST_OF_TYPES, 32767.0, 65535.0, 2147483647.0, 4294967295.0, -9999.0, 9999.0, 99999.0, 88888.0)
"""Numbers that stand for no reading where all axes have them: ends of types, and those of data formats."""


MOST_MISSING = 0.501
"""Part of a sensor's readings above which it counts as not there: a driver at half the rate may lose a few besides."""


def codes_of(stream: str, raw: FloatArray) -> NDArray[np.int8]:
    """Return for each (n, width) reading, in the unit of its file, the code of why it is missing; 0 where it is there.

    A channel that is NaN has no reading there, which is no fault.

    Parameters
    ----------
    stream : str
        ``tam_1`` … or the channel's name.
    raw : (n, width) array
        As they were recorded.
    """
    codes = np.zeros(len(raw), dtype=np.int8)
    if is_channel(stream) and stream != "scalar":
        return codes
    odd = ~(np.abs(raw) < HUGE) | (raw == _LEAST_OF_TYPES[0]) | (raw == _LEAST_OF_TYPES[1])
    same = raw[:, 0] == raw[:, -1]
    # Few readings are suspect, and only they need a look at all axes.
    suspect = np.flatnonzero(same | odd.any(axis=1) if odd.any() else same)
    if len(suspect) < len(raw):
        codes[suspect] = codes_of(stream, raw[suspect])
        return codes
    same = np.all(raw == raw[:, :1], axis=1)
    is_dummy = (same & np.isin(raw[:, 0], _DUMMIES)) | np.any(np.abs(raw) >= HUGE, axis=1)
    if not is_channel(stream):
        is_dummy |= np.isin(raw, _LEAST_OF_TYPES).any(axis=1)
        codes[np.isnan(raw).any(axis=1)] = NAN
    codes[is_dummy & (codes == 0)] = SENTINEL
    codes[(raw == 0).all(axis=1)] = ZERO
    return codes


def _may_stand_for_none(raw: Sequence[float]) -> bool:
    """Return whether one reading may have a code other than 0: quicker than `codes_of`, which decides."""
    for value in raw:
        if not -HUGE < value < HUGE or value in _LEAST_OF_TYPES:
            return True
    return (raw[0] == 0.0 or raw[0] in _DUMMIES) and all(value == raw[0] for value in raw)


@dataclass(frozen=True, eq=False)
class Range:
    """Range of a sensor or of the scalar, from most of its readings."""

    center: FloatArray
    reach: float

    @classmethod
    def of(cls, stream: str, raw: FloatArray) -> "Range":
        """Return the range that readings show, (n, width) without those that are missing; all where they are few."""
        if len(raw) < 2 * FEWEST_SAMPLES or (is_channel(stream) and stream != "scalar"):
            return cls(np.zeros(raw.shape[1]), np.inf)
        # So many readings give the ninth decile to a hundredth.
        raw = raw[:: len(raw) // 4096 + 1]
        center = np.nanmedian(raw, axis=0)
        if stream == "scalar":
            # No source that is passed changes the intensity so much.
            return cls(center, 4.0)
        distance = np.linalg.norm(raw - center, axis=1)
        field = float(np.median(np.linalg.norm(raw, axis=1)))
        # A turned sensor reaches twice the spread; a turn and a bias give twice the field on each axis.
        return cls(center, max(5.0 * float(np.quantile(distance, 0.9)), 4.0 * field))

    def beyond(self, raw: FloatArray) -> NDArray[np.bool_]:
        """Return which of (n, width) readings lie far outside."""
        if self.reach == np.inf:
            return np.zeros(len(raw), dtype=bool)
        if raw.shape[1] == 1:
            ratio = raw[:, 0] / self.center[0]
            return np.asarray((ratio > self.reach) | (ratio < 1 / self.reach))
        away = raw - self.center
        return np.asarray(np.einsum("ij,ij->i", away, away) > self.reach**2)


class Missing:
    """The missing readings of a recording, counted by stream and reason.

    Attributes
    ----------
    received : Counter of str
        Readings of each stream, those that are missing among them.
    counts : Counter of (str, int)
        Missing readings by stream and code.
    """

    def __init__(self) -> None:
        self.received, self.counts = Counter[str](), Counter[tuple[str, int]]()
        # The first times at which each was missing, seconds from the start; empty where they have no time.
        self._times_s = defaultdict[tuple[str, int], list[float]](list)

    def add(self, stream: str, codes: NDArray[np.int8], time_s: FloatArray | None) -> None:
        """Count readings.

        Parameters
        ----------
        stream : str
            ``tam_1`` … or the channel's name.
        codes : (n,) array of int
            Of `codes_of`, those far outside among them.
        time_s : (n,) array, optional
            Seconds from the start of the recording.
        """
        self.received[stream] += len(codes)
        for code in np.unique(codes[codes > 0]).tolist():
            index, key = np.flatnonzero(codes == code), (stream, code)
            self.counts[key] += len(index)
            if time_s is not None:
                self._times_s[key] += time_s[index[: MOST_NAMED - len(self._times_s[key])]].tolist()

    def of(self, stream: str) -> int:
        """Return how many readings of a stream are missing."""
        return sum(count for (name, _), count in self.counts.items() if name == stream)

    def mostly(self) -> dict[str, str]:
        """Return a sentence for each stream that lacks more than half of its readings, with the reasons."""
        sentences = {}
        for stream, received in self.received.items():
            if self.of(stream) > MOST_MISSING * received:
                reasons = "; ".join(self._sentence(*key) for key in self.counts if key[0] == stream)
                far = self.counts[stream, FAR] + self.counts[stream, BEYOND]
                hint = ": do these have another unit?" if 2 * far > received else ""
                sentences[stream] = f"more than half of the readings of {in_words(stream)} are missing: {reasons}{hint}"
        return sentences

    def require_half(self) -> None:
        """Check that no sensor lacks more than half of its readings.

        Raises
        ------
        InputError
            It names the sensor and why.
        """
        for sentence in self.mostly().values():
            raise InputError(sentence)

    def sentences(self) -> tuple[str, ...]:
        """Return a clause for each stream and reason."""
        return tuple(self._sentence(*key) for key in self.counts)

    def _sentence(self, stream: str, code: int) -> str:
        count, times_s = self.counts[stream, code], self._times_s[stream, code]
        when = f", {first_at(times_s)}" if times_s else ""
        return f"{count} of {self.received[stream]} readings of {in_words(stream)} {are(code, count, stream)}{when}"


def are(code: int, count: int, stream: str = "") -> str:
    """Return the verb and the reason of so many missing readings: is a sentinel, are zero on all axes."""
    reason = "zero" if (stream, code) == ("scalar", ZERO) else REASONS[code]
    return f"are {reason}" if count != 1 else "is a sentinel" if code == SENTINEL else f"is {reason}"


class _GrowingRange:
    """The range of one stream by its readings until now."""

    def __init__(self, stream: str) -> None:
        self._stream, self._kept = stream, list[Sequence[float]]()
        self._seen, self._due, self._stride = 0, 2 * FEWEST_SAMPLES, 1
        self._center, self._reach = [0.0], math.inf

    def is_beyond(self, raw: Sequence[float]) -> bool:
        """Take a reading, and return whether it lies far outside, as `Range.beyond`."""
        self._seen += 1
        if self._seen % self._stride == 0:
            self._kept.append(raw)
        if self._seen >= self._due:
            self._renew()
        if self._reach == math.inf:
            return False
        if self._stream == "scalar":
            return not self._center[0] / self._reach <= raw[0] <= self._center[0] * self._reach
        return math.dist(raw, self._center) > self._reach

    def _renew(self) -> None:
        found = Range.of(self._stream, np.array(self._kept))
        self._center, self._reach = found.center.tolist(), found.reach
        self._due = self._seen + self._seen // 4  # an arc that grows by a quarter stays far within five times
        if len(self._kept) > 1024:
            self._kept, self._stride = self._kept[1::2], 2 * self._stride


class LiveMissing(Missing):
    """The missing readings of streams whose readings come one by one."""

    def __init__(self) -> None:
        super().__init__()
        self._ranges: dict[str, _GrowingRange] = {}

    def take(self, stream: str, raw: Sequence[float], is_beyond: bool = False) -> int:
        """Count a reading, and return the code of why it is missing; 0 where it is there.

        As `codes_of` and `Range` judge a recording; the range follows from the readings so far, from the 18th on.

        Parameters
        ----------
        stream, raw
            As of `codes_of`: one reading.
        is_beyond : bool
            Whether no sensor reads so much: the range is that of the others.
        """
        if stream not in self._ranges:
            self._ranges[stream] = _GrowingRange(stream)
        self.received[stream] += 1
        if is_beyond or _may_stand_for_none(raw):
            code = int(codes_of(stream, np.array([raw]))[0]) or BEYOND * is_beyond
        else:
            code = FAR * self._ranges[stream].is_beyond(raw)
        if code:
            self.counts[stream, code] += 1
        return code


def in_words(stream: str) -> str:
    """Return a stream for people: ``tam_2`` is sensor 2, the scalar is the scalar."""
    return f"sensor {stream.removeprefix('tam_')}" if stream.startswith("tam_") else f"the {stream}"
