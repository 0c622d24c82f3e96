"""Readings that a driver repeats, delivers late, or fills in for lost ones."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.displaced import (
    NOWHERE_T,
    AgainstOthers,
    Explained,
    bursts_of,
    displaced,
    drawn_bursts,
    finding_of,
    position_nats,
    samples_in,
)
from tam_calibration.effects.effect import Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import MOST, NEGLIGIBLE
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.units import FloatArray

LATEST = 8
"""Longest delay of a reading, in samples: the length of a usual queue."""


class StaleSamples(FoundEffect):
    """Readings of a sensor that are those of some samples before.

    A telegram that goes out before the sensor has a new value holds the last one; a packet that was held up on its way
    is stamped when it comes. The sensor then reads what it should have read k samples before, b(t_n - k): its residual
    is -M (b_n - b_{n-k}), along the path of the field and as large as the way that this has made meanwhile.
    """

    name = "stale_samples"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no other sensor, where that is so."""
        return "one sensor alone does not tell where the field was" if covariates.sensor_count == 1 else None

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the samples that are stale, flagged, or why there is none."""
        found = []
        for sensor in range(residuals.covariates.sensor_count):
            against = AgainstOthers.of(residuals, sensor).recalibrated()
            back = _ways_back(against)
            which = displaced(against, back)
            if 0 < np.sum(which >= 0) < MOST * len(which):
                found.append(_late(against, which, back))
        if not found:
            return "no sensor reads at some times what it should have read just before"
        count = residuals.covariates.sample_count
        nats = sum(position_nats(count, int(one.samples.sum())) for one in found)
        return finding_of(self.name, residuals, found, nats)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        count = len(rows_T)
        (starts, burst), late = drawn_bursts(part, count, source), samples_in(part, "samples late", count)
        struck = np.minimum(starts[:, None] + np.arange(burst), count - 1)
        taken = np.broadcast_to(starts[:, None] - 1, struck.shape) if part.term == "repeats" else struck - late
        rows_T[struck] = rows_T[np.maximum(taken, 0)]
        return rows_T


def _ways_back(against: AgainstOthers) -> FloatArray:
    """Return the residual (k, N, 3) of readings that are those of 1 to k samples before, tesla."""
    expected = against.expected_T
    back = np.full((LATEST, *expected.shape), NOWHERE_T)
    for stretch in against.residuals.covariates.stretches:
        own = expected[stretch]
        for late in range(1, min(LATEST, len(own) - 1) + 1):
            back[late - 1, stretch.start + late : stretch.stop] = own[:-late] - own[late:]
    return back


def _late(against: AgainstOthers, which: NDArray[np.intp], back: FloatArray) -> Explained:
    """Return how often and how long readings are stale, and by how much: a value is held, or packets are late."""
    is_stale, samples = which >= 0, np.flatnonzero(which >= 0)
    late, left = which[samples] + 1, against.beyond_T.copy()
    left[samples] -= back[late - 1, samples]
    # A held value ages by a sample with each that repeats it.
    starts = samples[np.diff(samples, prepend=-2) > 1]
    since = samples - starts[np.searchsorted(starts, samples, side="right") - 1]
    is_held = np.sum(late == since + 1) > len(samples) / 2
    values, errors = bursts_of(is_stale)
    values["samples late"] = 1.0 if is_held else float(np.median(late))
    part = Contribution(against.sensor, None, "repeats" if is_held else "late packets", values, errors)
    return Explained(is_stale, left, part)


class InterpolatedSamples(FoundEffect):
    """Lost readings of a sensor, filled on straight lines between their neighbours.

    Where the field is in motion the line cuts its curve short: the residual is the error of linear interpolation, up to
    h²/8 |d²b/dt²| for a gap of duration h. Noise never goes straight in three axes at once: the second differences of
    what was filled vanish, to the last digit that is written.
    """

    name = "interpolated_samples"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no other sensor, where that is so."""
        return "one sensor alone does not tell how the field went" if covariates.sensor_count == 1 else None

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the samples that were filled, flagged, or why there are none."""
        found = []
        for sensor in range(residuals.covariates.sensor_count):
            windows = _lines(residuals.recording.readings_T[:, sensor], residuals.covariates)
            if windows:
                found.append(_filled(AgainstOthers.of(residuals, sensor).recalibrated(), windows))
        if not found:
            return "no sensor reads along straight lines where the others see the field turn"
        return finding_of(self.name, residuals, found, is_certain=True)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        rows, count = rows_T.copy(), len(rows_T)
        starts, burst = drawn_bursts(part, count, source)
        for start in starts[(starts > 0) & (starts + burst < count)]:
            inside = np.arange(start, start + burst)
            rows[inside] = _on_line(rows_T, inside)
        return rows


def _lines(readings_T: FloatArray, covariates: Covariates) -> list[NDArray[np.intp]]:
    """Return the samples of each row that goes straight in all axes and is longer than chance lets one be.

    Chance is that of the samples of which some axes go straight, and others do not.
    """
    count = len(readings_T)
    digit = np.array([_digit(axis) for axis in readings_T.T])
    bend, step = np.full((count, 3), np.inf), np.zeros((count, 3))
    for stretch in covariates.stretches:
        if stretch.stop - stretch.start > 2:
            bend[stretch.start + 1 : stretch.stop - 1] = np.diff(readings_T[stretch], 2, axis=0)
            step[stretch.start + 1 : stretch.stop] = np.diff(readings_T[stretch], axis=0)
    goes_straight = np.abs(bend) <= 2 * digit
    is_straight = goes_straight.all(axis=1) & (np.abs(step) > 4 * digit).any(axis=1)
    chance = float(np.prod((goes_straight[~is_straight].sum(axis=0) + 1) / (np.sum(~is_straight) + 1)))
    rows = np.split(np.arange(count), np.flatnonzero(np.diff(is_straight)) + 1)
    return [row for row in rows if is_straight[row[0]] and count * chance ** len(row) < NEGLIGIBLE]


def _digit(values: FloatArray) -> float:
    """Return the smallest step between values (N,) that differ by more than the rounding of the computer."""
    steps = np.diff(np.unique(values))
    return float(np.min(steps[steps > 1e-13 * np.abs(values).max()], initial=np.ptp(values)))


def _on_line(values: FloatArray, inside: NDArray[np.intp]) -> FloatArray:
    """Return values (n, C) on the straight lines between the neighbours of some samples (n,) that follow each other."""
    ends = [max(inside[0] - 1, 0), min(inside[-1] + 1, len(values) - 1)]
    return np.column_stack([np.interp(inside, ends, own) for own in values[ends].T])


def _filled(against: AgainstOthers, windows: Sequence[NDArray[np.intp]]) -> Explained:
    """Return the samples of the rows, what lines between their ends leave of the residual, and the numbers."""
    left, are_filled = against.beyond_T.copy(), np.zeros(len(against.beyond_T), dtype=bool)
    for inside in windows:
        are_filled[inside] = True
        left[inside] += against.expected_T[inside] - _on_line(against.expected_T, inside)
    return Explained(are_filled, left, Contribution(against.sensor, None, "lines", *bursts_of(are_filled)))
