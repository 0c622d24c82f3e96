"""Sensors that repeat another, at once or some samples later, in one pass through all samples; axes that do."""

from itertools import permutations
from math import log

import numpy as np

from tam_calibration.integrity.fault import Fault, between, channel
from tam_calibration.integrity.overview import Overview
from tam_calibration.model.recording import Block
from tam_calibration.model.units import FloatArray

SURE = 1e-6
"""Probability of a false alarm in one recording."""


def is_chance(equal: int, share: float, count: int) -> bool:
    """Whether so many equalities in a row may happen by chance.

    Parameters
    ----------
    equal : int
        Number of equalities in a row.
    share : float
        Chance of one equality, above 0: how often it happens elsewhere.
    count : int
        Number of samples, at each of which the row may begin.
    """
    return share >= 1 or equal * log(share) > log(SURE / count)


SHORTEST = 10
"""Different readings in a row that a copy repeats at least."""

PROBES = 16
"""Readings of a sensor in each block that are looked for among those of the others."""

FOUND = 4
"""Of these, that are met again equally late, before a copy is looked for there."""

LATEST = 4096
"""Samples by which a copy may be late: 40 s at 100 Hz."""

COPIED = 1 - 1e-13
"""Correlation of two axes that differ by rounding only; noise of a millionth of the readings' spread makes less."""

FLAT = 1e-12
"""Variance out of a plane of readings without noise, in units of theirs: axes agree there because the field does."""

_MIXED = np.array([1.0, 0.6180339887498949, 0.41421356237309503])
"""Weights of x, y and z in the number by which readings are compared: different readings have different ones."""


class _Pair:
    """The longest stretch in which one sensor reads what another read some samples before."""

    def __init__(self) -> None:
        self.longest, self.equal, self.late = 0, 0, 0
        self.time_s = 0.0, 0.0

    def add(self, copy: FloatArray, original: FloatArray, time_s: FloatArray, late: int) -> None:
        is_equal = copy == original
        is_new = np.append(True, copy[1:] != copy[:-1])
        self.equal += int((is_equal & is_new).sum())
        edges = np.flatnonzero(np.diff(np.concatenate([[False], is_equal, [False]]).astype(np.int8)))
        new = np.concatenate([[0], np.cumsum(is_new)])
        for start, stop in zip(edges[::2], edges[1::2], strict=True):
            if (length := int(new[stop] - new[start])) > self.longest:
                self.longest, self.late = length, late
                self.time_s = float(time_s[start]), float(time_s[stop - 1])

    def is_copy(self, count: int) -> bool:
        """Whether the stretch is longer than chance makes it, in so many samples."""
        share = (self.equal - self.longest + 1) / (count - self.longest + 2)
        return self.longest >= SHORTEST and not is_chance(self.longest - 1, share, count)


class Copies:
    """Which sensor repeats which.

    Parameters
    ----------
    sensor_count : int
        Number of sensors K.
    """

    def __init__(self, sensor_count: int) -> None:
        self._count, self._sensors = 0, sensor_count
        self._pairs = {pair: _Pair() for pair in permutations(range(sensor_count), 2)}

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        self._count += len(block.time_s)
        if not self._pairs:
            return
        numbers = np.ascontiguousarray((block.readings_T.reshape(-1, 3) @ _MIXED).reshape(-1, self._sensors).T)
        for copy, original in self._pairs:
            if copy > original and (numbers[copy] == numbers[original]).any():
                self._pairs[copy, original].add(numbers[copy], numbers[original], block.time_s, 0)
        for copy, original, late in _lags(numbers[:, :LATEST]):
            self._pairs[copy, original].add(numbers[copy, late:], numbers[original, :-late], block.time_s[late:], late)

    def faults(self, overview: Overview) -> list[Fault]:
        """Return what repeats what.

        Parameters
        ----------
        overview : Overview
            Of what was added.
        """
        faults, known = [], set()
        for (copy, original), pair in self._pairs.items():
            if pair.is_copy(self._count):
                known.add(frozenset((copy, original)))
                when = f" {pair.late} samples later" if pair.late else ""
                sentence = (
                    f"sensor {copy + 1} repeats sensor {original + 1}{when} {between(pair.time_s)}: "
                    "it is no sensor of its own"
                )
                faults.append(Fault("repeated", copy + 1, "", pair.time_s, sentence))
        return faults + _axes(overview, known)


def _lags(numbers: FloatArray) -> list[tuple[int, int, int]]:
    """Return copy, original and how many samples later, where several probes (K, n) are met again."""
    count = numbers.shape[1]
    if count < 2 * PROBES:
        return []
    place = np.linspace(0, count - 1, PROBES + 2).astype(int)[1:-1]
    probes = numbers[:, place].ravel()
    order = np.argsort(probes)
    at = np.minimum(np.searchsorted(probes[order], numbers.ravel()), len(probes) - 1)
    met = np.flatnonzero(probes[order[at]] == numbers.ravel())
    copy, here = np.divmod(met, count)
    original, probe = np.divmod(order[at[met]], PROBES)
    late = here - place[probe]
    later = (copy != original) & (late > 0)
    found, times = np.unique(np.stack([copy, original, late])[:, later], axis=1, return_counts=True)
    return [(int(k), int(j), int(lag)) for k, j, lag in found[:, times >= FOUND].T]


def _axes(overview: Overview, known: set[frozenset[int]]) -> list[Fault]:
    """Return the axes that repeat another but for scale and offset."""
    centered = overview.values_T - overview.values_T.mean(axis=1, keepdims=True)
    is_constant = overview.sorted_T[:, 0] == overview.sorted_T[:, -1]
    size = np.where(is_constant, 0, np.sqrt(np.einsum("in,in->i", centered, centered)))
    unit = np.divide(centered, size[:, None], out=np.zeros_like(centered), where=size[:, None] > 0)
    faults = []
    correlation, count = unit @ unit.T, overview.sensor_count
    own = correlation.reshape(count, 3, count, 3)[range(count), :, range(count)]
    is_flat = np.linalg.eigvalsh(own)[:, 0] < FLAT
    for copy, original in np.argwhere(np.tril(np.abs(correlation) > COPIED, -1)).tolist():
        witnesses = is_flat if copy // 3 != original // 3 else np.delete(is_flat, copy // 3)
        if frozenset((copy // 3, original // 3)) not in known and not (len(witnesses) and witnesses.all()):
            one, other = (channel(row // 3 + 1, "xyz"[row % 3]) for row in (copy, original))
            sentence = f"{one} repeats {other} but for scale and offset {between(overview.time_s)}"
            sentence += ": it is no axis of its own"
            faults.append(Fault("repeated", copy // 3 + 1, "xyz"[copy % 3], overview.time_s, sentence))
    return faults
