"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
penalised by their code length: k positions among N samples take ln C(N, k) nats and a shift of variance v ½ ln v,
where BIC takes ½ ln n per parameter; that is about two parameters for a single spike, fewer for each of many.
"""

from collections.abc import Iterator

import numpy as np

from tam_calibration.effects.displaced import drawn_bursts, position_nats
from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, WhitenedResiduals
from tam_calibration.effects.spikes import Spikes, find_spikes
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
        flagged = np.zeros(len(residuals.energy), dtype=bool)
        flagged[spikes.samples] = True
        used = residuals.is_counted | flagged
        before, count = float(residuals.energy[used].sum()), float(residuals.channel_count[used].sum())
        rest = ~flagged & (residuals.channel_count > 0)
        floor = float(residuals.energy[rest].sum() / residuals.channel_count[rest].sum())
        place, saved, value_cost = _best_place(residuals, spikes, floor)
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


def _best_place(residuals: WhitenedResiduals, spikes: Spikes, floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    found = []
    for place, energy, freedom, choices in _offers(residuals, spikes):
        total = len(spikes.samples) * freedom
        variance = max(energy / floor / total, 1.0)
        cost = total * float(1 + np.log(variance)) + 2 * len(spikes.samples) * float(np.log(choices))
        found.append((energy / floor - cost, place, energy, cost))
    _, place, saved, cost = max(found, key=lambda item: item[0])
    return place, saved, cost


def _offers(residuals: WhitenedResiduals, spikes: Spikes) -> Iterator[tuple[Place, float, int, int]]:
    """Yield places with the energy that spikes explain there, the shifts of a sample, and among how many rows each is.

    Of several sensors, spikes may be in all rows at once, or each in a row of its own.
    """
    samples, count = spikes.samples, residuals.covariates.sensor_count
    for place in places(count)[count == 1 :]:
        yield place, float(explained_energy(residuals, samples, place).sum()), len(place.rows), 1
    if count > 1:
        whole, channels = everywhere(count), int(np.median(residuals.channel_count[samples]))
        yield whole, float(residuals.energy[samples].sum()), channels, 1
        single = row_deviations(residuals)[samples]
        yield whole, float(np.max(single**2, axis=1).sum()), 1, 3 * count + 1


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
