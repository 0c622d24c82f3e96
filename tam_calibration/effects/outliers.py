"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
penalised by their code length: k positions among N samples take ln C(N, k) nats and a shift of variance v ½ ln v,
where BIC takes ½ ln n per parameter; that is about two parameters for a single spike, fewer for each of many.
"""

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.displaced import drawn_bursts
from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, WhitenedResiduals
from tam_calibration.effects.spikes import Spikes, come_with_motion, find_spikes
from tam_calibration.effects.term import Place, everywhere, explained_energy, places, row_deviations
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.units import FloatArray


class Outliers(FoundEffect):
    """Spikes in single readings."""

    name = "outliers"

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the spikes, flagged, or why there is none."""
        spikes = find_spikes(residuals)
        if isinstance(spikes, str):
            return spikes
        if come_with_motion(residuals, spikes):
            return "the spikes come where the field changes fastest, or where it stands still"
        flagged = np.zeros(len(residuals.energy), dtype=bool)
        flagged[spikes.samples] = True
        used = residuals.is_counted | flagged
        before, count = float(residuals.energy[used].sum()), float(residuals.channel_count[used].sum())
        scale = _floor(residuals, flagged)
        place, saved, value_cost = _best_place(residuals, spikes, scale)
        left = max(before - saved, np.finfo(float).tiny)
        paid = 2 * position_nats(len(flagged), len(spikes.samples)) + value_cost
        return Finding(
            FittedEffect(self.name, {}, _contributions(residuals, spikes, place)),
            gain=count * float(np.log(before / left)),
            parameter_count=1 + int(np.ceil(paid / np.log(count))),
            flagged=flagged,
        )

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        starts, burst = drawn_bursts(part, len(rows_T), source)
        struck = np.unique(np.minimum(starts[:, None] + np.arange(burst), len(rows_T) - 1))
        rows_T[struck] += source.normal(0, part.values["size"], rows_T[struck].shape)
        return rows_T


def _floor(residuals: WhitenedResiduals, flagged: NDArray[np.bool_]) -> float:
    """Return the variance of the whitened channels of the samples that are not flagged."""
    rest = ~flagged & (residuals.channel_count > 0)
    return float(residuals.energy[rest].sum() / residuals.channel_count[rest].sum())


def _best_place(residuals: WhitenedResiduals, spikes: Spikes, floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    samples, count = spikes.samples, residuals.covariates.sensor_count
    candidates = [(place, explained_energy(residuals, samples, place), len(place.rows)) for place in places(count)]
    if count > 1:
        whole = everywhere(count)
        candidates.append((whole, residuals.energy[samples], int(np.median(residuals.channel_count[samples]))))
        # Each spike in a row of its own, whose index adds to the code length.
        single = row_deviations(residuals)[samples]
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
    """Return ln C(N, k), the code length of the flagged samples, in nats.

    Parameters
    ----------
    sample_count : int
        Number of samples N.
    chosen : int
        Number of flagged samples k.
    """
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))


def _contributions(residuals: WhitenedResiduals, spikes: Spikes, place: Place) -> tuple[Contribution, ...]:
    samples = spikes.samples
    rate = len(samples) / len(residuals.energy)
    runs = 1 + int(np.sum(np.diff(samples) > 1))
    parts = []
    for sensor, axis in place.contribution_keys():
        rows = [row for row in place.rows if axis is None or row % 3 == axis or sensor == SCALAR]
        shift = residuals.row_shift_T[samples[:, None], rows]
        if sensor == ALL:
            shift = residuals.row_shift_T[samples, spikes.rows]
        size = float(np.sqrt(np.mean(shift**2)))
        values = {"rate": rate, "size": size, "burst": len(samples) / runs}
        errors = {"rate": float(np.sqrt(rate * (1 - rate) / len(residuals.energy)))}
        errors["size"] = size / float(np.sqrt(2 * shift.size))
        parts.append(Contribution(sensor, axis, "spikes", values, errors))
    return tuple(parts)
