"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
paid as a code: k positions among N samples are ln C(N, k) nats and a shift of variance v costs ½ ln v, where BIC takes
½ ln n for a parameter; that is about two parameters for a lone spike, fewer for each of many.
"""

from collections.abc import Mapping
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
    Limit,
    Misfit,
    Situation,
)
from tam_calibration.effects.places import Place, everywhere, explained_energy, places, row_deviations, rows_of
from tam_calibration.effects.saturation import WIDEST_RANGE
from tam_calibration.effects.spikes import Spikes, come_with_motion, find_spikes
from tam_calibration.units import FloatArray


class Outliers(FoundEffect):
    """Spikes in single readings."""

    name = "outliers"
    title = "spikes in single readings"
    physics = (
        "A disturbance of the transmission or a short event nearby puts single readings, or a few in a row, far off "
        "(Cook and Weisberg 1982, mean-shift model)."
    )
    excitation = "a record of at least some dozens of samples"
    may_repeat = True
    is_of_lone_samples = True
    units: ClassVar[Mapping[str, str]] = {"rate": "1", "size": "T", "burst": "1"}
    limits: ClassVar[Mapping[str, Limit]] = {"size": WIDEST_RANGE}

    def find(self, misfit: Misfit) -> Finding | str:
        """Return the spikes, flagged, or why there is none."""
        spikes = find_spikes(misfit)
        if isinstance(spikes, str):
            return spikes
        if come_with_motion(misfit, spikes):
            return "the spikes come where the field changes fastest, or where it stands still"
        flagged = np.zeros(len(misfit.energy), dtype=bool)
        flagged[spikes.samples] = True
        used = misfit.is_counted | flagged
        before, count = float(misfit.energy[used].sum()), float(misfit.channel_count[used].sum())
        scale = _floor(misfit, flagged)
        place, saved, value_cost = _best_place(misfit, spikes, scale)
        left = max(before - saved, np.finfo(float).tiny)
        paid = 2 * position_nats(len(flagged), len(spikes.samples)) + value_cost
        return Finding(
            FittedEffect(self.name, {}, _contributions(misfit, spikes, place)),
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


def _floor(misfit: Misfit, flagged: NDArray[np.bool_]) -> float:
    """Return the variance of the whitened channels of the samples that are not flagged."""
    rest = ~flagged & (misfit.channel_count > 0)
    return float(misfit.energy[rest].sum() / misfit.channel_count[rest].sum())


def _best_place(misfit: Misfit, spikes: Spikes, floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    samples, count = spikes.samples, misfit.situation.sensor_count
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


def position_nats(sample_count: int, chosen: int) -> float:
    """Return ln C(N, k), the nats that tell which samples are struck."""
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))


def _contributions(misfit: Misfit, spikes: Spikes, place: Place) -> tuple[Contribution, ...]:
    samples = spikes.samples
    rate = len(samples) / len(misfit.energy)
    runs = 1 + int(np.sum(np.diff(samples) > 1))
    parts = []
    for sensor, axis in place.contribution_keys():
        rows = [row for row in place.rows if axis is None or row % 3 == axis or sensor == SCALAR]
        shift = misfit.row_shift_T[samples[:, None], rows]
        if sensor == ALL:
            shift = misfit.row_shift_T[samples, spikes.rows]
        size = float(np.sqrt(np.mean(shift**2)))
        values = {"rate": rate, "size": size, "burst": len(samples) / runs}
        errors = {"rate": float(np.sqrt(rate * (1 - rate) / len(misfit.energy)))}
        errors["size"] = size / float(np.sqrt(2 * shift.size))
        parts.append(Contribution(sensor, axis, "spikes", values, errors))
    return tuple(parts)
