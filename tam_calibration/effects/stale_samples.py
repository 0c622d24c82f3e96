"""Stale samples: a reading that is the one before, or a packet that is late.

A telegram that goes out before the sensor has a new value holds the last one; a packet that was held up on its way is
stamped when it comes. The sensor then reads what it should have read k samples before, b(t_n - k): its residual is
-M (b_n - b_{n-k}), along the path of the field and as large as the way that this has made meanwhile.
"""

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.displaced import (
    NOWHERE_T,
    AgainstOthers,
    Explained,
    displaced,
    drawn_bursts,
    finding_of,
    position_nats,
    samples_in,
)
from tam_calibration.effects.effect import Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import MOST
from tam_calibration.effects.term import WhitenedResiduals
from tam_calibration.model.units import FloatArray

LATEST = 8
"""Longest delay of a reading, in samples: the length of a usual queue."""


class StaleSamples(FoundEffect):
    """Readings of a sensor that are those of some samples before."""

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
                found.append(_explained(against, which, back))
        if not found:
            return "no sensor reads at some times what it should have read just before"
        count = residuals.covariates.sample_count
        nats = sum(position_nats(count, int(one.samples.sum())) for one in found)
        return finding_of(self.name, residuals, found, len(found), nats)

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
        for late in range(1, min(LATEST, stretch.stop - stretch.start - 1) + 1):
            back[late - 1, stretch.start + late : stretch.stop] = (
                expected[stretch.start : stretch.stop - late] - expected[stretch.start + late : stretch.stop]
            )
    return back


def _explained(against: AgainstOthers, which: NDArray[np.intp], back: FloatArray) -> Explained:
    """Return how often and how long readings are stale, and by how much: a value is held, or packets are late."""
    is_stale, samples = which >= 0, np.flatnonzero(which >= 0)
    late, left = which[samples] + 1, against.beyond_T.copy()
    left[samples] -= back[late - 1, samples]
    rate, runs = len(samples) / len(is_stale), 1 + int(np.sum(np.diff(samples) > 1))
    is_held = _held(samples, late) > len(samples) / 2
    values = {"rate": rate, "burst": len(samples) / runs, "samples late": 1.0 if is_held else float(np.median(late))}
    errors = {"rate": float(np.sqrt(rate * (1 - rate) / len(is_stale)))}
    part = Contribution(against.sensor, None, "repeats" if is_held else "late packets", values, errors)
    return Explained(is_stale, left, part)


def _held(samples: NDArray[np.intp], late: NDArray[np.intp]) -> int:
    """Return the number of samples that hold the value of the last that was not stale."""
    starts = samples[np.diff(samples, prepend=-2) > 1]
    since = samples - starts[np.searchsorted(starts, samples, side="right") - 1]
    return int(np.sum(late == since + 1))
