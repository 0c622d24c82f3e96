"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

A reading is flagged where a shift of its row alone lies beyond what noise reaches in so many readings: the tail of
Student's distribution for a scale from the median (whose efficiency of 37 % gives the degrees of freedom), with the
false discovery rate of Benjamini and Hochberg (1995). The scale is the larger of the record's and that of the
surroundings, so that a noisy axis or a noisy while has no outliers. Left out are what lasts longer than a burst, what
neighbours on the sphere share, and readings at the end of an axis' range: these have causes of their own.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
paid as a code: k positions among N samples are ln C(N, k) nats and a shift of variance v costs ½ ln v, where BIC takes
½ ln n for a parameter; that is about two parameters for a lone spike, fewer for each of many.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.effect import (
    ALL,
    SCALAR,
    Contribution,
    Finding,
    FittedEffect,
    FoundEffect,
    Misfit,
    Situation,
)
from tam_calibration.effects.places import Place, everywhere, explained_energy, places, row_deviations
from tam_calibration.effects.saturation import find_limits, rows_of
from tam_calibration.units import FloatArray

LONGEST_BURST = 8
"""Samples; what lasts longer is no spike."""

_FALSE_DISCOVERIES = 0.02
_EFFICIENCY = 0.37
"""Of the median of absolute values as an estimate of a Gaussian scale."""

_NORMAL = 1.4826
_BLOCK = 200
"""Samples over which the scale of the surroundings is taken."""

_HOT = 3.0
"""Standard deviations beyond which a sample beside a spike belongs to the same burst."""

_MOST = 0.15
"""Part of the samples; more cannot be outliers."""

_NEIGHBOURS = 8
_SHARED = 0.3
"""Part of a spike that its neighbours on the sphere or in time may share."""

_AROUND = 25
"""Samples on either side against whose scale a spike must stand out as well."""

_IN_TIME = slice(_AROUND - _NEIGHBOURS // 2, _AROUND + _NEIGHBOURS // 2)
_STANDS_OUT = 3.5

_MOST_NEIGHBOURS = 20_000
_CLUSTERED = 1e-3
"""Probability below which bursts do not come at random times."""


@dataclass(frozen=True, eq=False)
class _Suspects:
    samples: NDArray[np.intp]
    rows: NDArray[np.intp]
    deviation: FloatArray


class Outliers(FoundEffect):
    """Spikes in single readings."""

    name = "outliers"
    title = "spikes in single readings"
    physics = (
        "A disturbance of the transmission or a short event nearby puts single readings, or a few in a row, far off "
        "(Cook and Weisberg 1982, mean-shift model)."
    )
    excitation = "a record of at least some dozens of samples"
    units: ClassVar[Mapping[str, str]] = {"rate": "1", "size": "T", "burst": "1"}

    def find(self, misfit: Misfit) -> Finding | str:
        """Return the spikes, flagged, or why there is none."""
        suspects = _suspects(misfit)
        if isinstance(suspects, str):
            return suspects
        flagged = np.zeros(len(misfit.energy), dtype=bool)
        flagged[suspects.samples] = True
        used = misfit.is_counted | flagged
        before, count = float(misfit.energy[used].sum()), float(misfit.channel_count[used].sum())
        scale = _floor(misfit, flagged)
        place, saved, value_cost = _best_place(misfit, suspects, scale)
        left = max(before - saved, np.finfo(float).tiny)
        paid = 2 * _positions(len(flagged), len(suspects.samples)) + value_cost
        return Finding(
            FittedEffect(self.name, {}, _contributions(misfit, suspects, place)),
            gain=count * float(np.log(before / left)),
            parameter_count=1 + int(np.ceil(paid / np.log(count))),
            flagged=flagged,
        )

    def add(
        self, rows_T: FloatArray, situation: Situation, fitted: FittedEffect, generator: np.random.Generator
    ) -> FloatArray:
        """Return simulated rows (N, 3K + 1) with the effect in them, tesla."""
        rows, count = rows_T.copy(), situation.sample_count
        for part in fitted.contributions:
            burst = max(1, round(part.values.get("burst", 1.0)))
            starts = np.flatnonzero(generator.random(count) < part.values["rate"] / burst)
            struck = np.unique(np.minimum(starts[:, None] + np.arange(burst), count - 1))
            touched = rows_of(part, situation)
            rows[struck[:, None], touched] += generator.normal(0, part.values["size"], (len(struck), len(touched)))
        return rows


def _suspects(misfit: Misfit) -> _Suspects | str:
    """Return the samples that no noise explains and that stand alone, with the row that shows each best."""
    usable = misfit.channel_count > 0
    for limit in find_limits(misfit):
        usable[limit.samples] = False
    if usable.sum() < 2 * LONGEST_BURST:
        return "there are too few samples to tell a spike from noise"
    raw = row_deviations(misfit)
    deviation = _standardised(raw, usable)
    # The row that explains most, not that which is off most: noise of one leaks into all.
    worst = np.argmax(np.abs(raw), axis=1)
    height = np.abs(deviation[np.arange(len(worst)), worst]) * usable
    far = _beyond_noise(height, int(usable.sum()), deviation.shape[1])
    if not far.any():
        return "no reading lies beyond what noise reaches"
    if far.sum() > _MOST * usable.sum():
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    bursts = _bursts(height > _HOT)
    far &= bursts <= LONGEST_BURST
    if not far.any():
        return f"what is far off lasts longer than {LONGEST_BURST} samples"
    far[_shared(misfit, deviation, worst, far)] = False
    if not far.any():
        return "what is far off is so at neighbouring times or directions of the field as well"
    if _is_clustered(far, usable):
        return "what is far off comes in spells, as where the noise changes"
    samples = np.flatnonzero(far)
    return _Suspects(samples, worst[samples], height[samples])


def _standardised(raw: FloatArray, usable: NDArray[np.bool_]) -> FloatArray:
    """Return the deviation of each row in units of the larger of the record's scale and that of the surroundings."""
    deviation = np.where(usable[:, None], raw, 0)
    chosen = np.abs(deviation[usable])
    count = max(1, len(chosen) // _BLOCK)
    size = len(chosen) // count
    blocks = chosen[: count * size].reshape(count, size, -1)
    scale = _NORMAL * np.median(blocks, axis=1)
    scale = np.maximum(scale, _NORMAL * np.median(chosen, axis=0))
    index = np.zeros(len(deviation), dtype=np.intp)
    index[usable] = np.minimum(np.arange(len(chosen)) // size, count - 1)
    scale = np.where(scale > 0, scale, np.inf)
    standardised: FloatArray = deviation / scale[index]
    return standardised


def _beyond_noise(height: FloatArray, count: int, row_count: int) -> NDArray[np.bool_]:
    """Return the samples whose largest deviation is improbable, by the false discovery rate among all."""
    from scipy.special import stdtr

    freedom = _EFFICIENCY * min(count, _BLOCK)
    chance = np.minimum(1.0, 2 * row_count * stdtr(freedom, -height))
    ordered = np.sort(chance)
    allowed = ordered <= _FALSE_DISCOVERIES * np.arange(1, len(chance) + 1) / count
    if not allowed.any():
        return np.zeros(len(chance), dtype=bool)
    improbable: NDArray[np.bool_] = chance <= ordered[np.flatnonzero(allowed)[-1]]
    return improbable


def _bursts(hot: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the length of the unbroken run of hot samples that each sample is in, 0 outside."""
    edges = np.flatnonzero(np.diff(hot.astype(np.int8), prepend=0, append=0))
    lengths = np.zeros(len(hot), dtype=np.intp)
    for start, stop in edges.reshape(-1, 2):
        lengths[start:stop] = stop - start
    return lengths


def _shared(misfit: Misfit, deviation: FloatArray, worst: NDArray[np.intp], far: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the samples that neighbours in time or in the field's direction equal, or whose surroundings are loud."""
    from scipy.spatial import cKDTree

    others, samples = np.flatnonzero(~far & (misfit.channel_count > 0)), np.flatnonzero(far)
    if len(others) < 4 * _NEIGHBOURS:
        return samples[:0]
    rows = worst[samples][:, None]
    own = deviation[samples, rows[:, 0]]
    order = np.searchsorted(others, samples)[:, None]
    around = others[np.clip(order + np.arange(-_AROUND, _AROUND), 0, len(others) - 1)]
    shared = np.median(deviation[around[:, _IN_TIME], rows], axis=1) / own > _SHARED
    usable = np.flatnonzero(misfit.channel_count > 0)
    thinned = usable[:: max(1, len(usable) // _MOST_NEIGHBOURS)]
    direction = misfit.situation.field_T / misfit.situation.intensity_T[:, None]
    near = thinned[cKDTree(direction[thinned]).query(direction[samples], 2 * _NEIGHBOURS)[1]]
    at_direction = np.where(np.abs(near - samples[:, None]) > LONGEST_BURST, deviation[near, rows], np.nan)
    several = np.sum(np.isfinite(at_direction), axis=1) >= _NEIGHBOURS
    shared[several] |= np.nanmedian(at_direction[several], axis=1) / own[several] > _SHARED
    shared |= np.abs(own) < _STANDS_OUT * _NORMAL * np.median(np.abs(deviation[around, rows]), axis=1)
    found: NDArray[np.intp] = samples[shared]
    return found


def _is_clustered(far: NDArray[np.bool_], usable: NDArray[np.bool_]) -> bool:
    """Return whether bursts crowd in parts of the record, by the index of dispersion of their numbers in blocks."""
    from scipy.special import chdtrc

    struck = np.flatnonzero(far[usable])
    starts = struck[np.diff(struck, prepend=-LONGEST_BURST - 1) > LONGEST_BURST]
    blocks = int(min(len(starts) // 2, 50))
    if blocks < 3:
        return False
    counts = np.bincount(starts * blocks // int(usable.sum()), minlength=blocks)
    dispersion = float(np.sum((counts - counts.mean()) ** 2) / counts.mean())
    return bool(chdtrc(blocks - 1, dispersion) < _CLUSTERED)


def _floor(misfit: Misfit, flagged: NDArray[np.bool_]) -> float:
    """Return the variance of the whitened channels of the samples that are not flagged."""
    rest = ~flagged & (misfit.channel_count > 0)
    return float(misfit.energy[rest].sum() / misfit.channel_count[rest].sum())


def _best_place(misfit: Misfit, suspects: _Suspects, floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    samples, count = suspects.samples, misfit.situation.sensor_count
    candidates = [(place, explained_energy(misfit, samples, place), len(place.rows)) for place in places(count)]
    if count > 1:
        whole = everywhere(count)
        candidates.append((whole, misfit.energy[samples], int(np.median(misfit.channel_count[samples]))))
        # Each spike in a row of its own, which has to be told.
        single = row_deviations(misfit)[samples]
        candidates.append((whole, np.max(single**2, axis=1), 1))
    else:
        candidates = candidates[1:]
    found = []
    for number, (place, energy, freedom) in enumerate(candidates):
        total = len(samples) * freedom
        variance = max(float(energy.sum()) / floor / total, 1.0)
        cost = total * float(np.log(variance))
        if count > 1 and number == len(candidates) - 1:
            cost += 2 * len(samples) * float(np.log(3 * count + 1))
        cost += total
        found.append((float(energy.sum()) / floor - cost, place, float(energy.sum()), cost))
    _, place, saved, cost = max(found, key=lambda item: item[0])
    return place, saved, cost


def _positions(sample_count: int, chosen: int) -> float:
    """Return ln C(N, k), the nats that tell which samples are struck."""
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))


def _contributions(misfit: Misfit, suspects: _Suspects, place: Place) -> tuple[Contribution, ...]:
    samples = suspects.samples
    rate = len(samples) / len(misfit.energy)
    runs = 1 + int(np.sum(np.diff(samples) > 1))
    parts = []
    for sensor, axis in place.contribution_keys():
        rows = [row for row in place.rows if axis is None or row % 3 == axis or sensor == SCALAR]
        shift = misfit.row_shift_T[samples[:, None], rows]
        if sensor == ALL:
            shift = misfit.row_shift_T[samples, suspects.rows]
        size = float(np.sqrt(np.mean(shift**2)))
        values = {"rate": rate, "size": size, "burst": len(samples) / runs}
        errors = {"rate": float(np.sqrt(rate * (1 - rate) / len(misfit.energy)))}
        errors["size"] = size / float(np.sqrt(2 * shift.size))
        parts.append(Contribution(sensor, axis, "spikes", values, errors))
    return tuple(parts)
