"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
penalised by their code length: k positions among N samples take ln C(N, k) nats and a shift of variance v ½ ln v,
where BIC takes ½ ln n per parameter; that is about two parameters for a single spike, fewer for each of many.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.displaced import bursts_of, drawn_bursts, position_nats
from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, WhitenedResiduals
from tam_calibration.effects.grades import LONGEST_BURST, MINOR
from tam_calibration.effects.term import Place, everywhere, explained_energy, places, row_deviations
from tam_calibration.model.fitted_effect import ALL, SCALAR, Contribution, FittedEffect
from tam_calibration.model.units import FloatArray

A_DOZEN = 12
"""Single readings that are no noise, whatever part of a short recording they are: a sixth of 72 poses."""


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
        rest = ~flagged & (residuals.channel_count > 0)
        floor = float(residuals.energy[rest].sum() / residuals.channel_count[rest].sum())
        place, saved, value_cost = _best_place(residuals, spikes, floor)
        fitted = FittedEffect(self.name, {}, _contributions(residuals, spikes, place, flagged))
        nats = position_nats(len(flagged), len(spikes.samples)) + value_cost / 2
        return Finding.of_samples(fitted, residuals, flagged, saved, 1, nats)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        starts, burst = drawn_bursts(part, len(rows_T), source)
        struck = np.unique(np.minimum(starts[:, None] + np.arange(burst), len(rows_T) - 1))
        rows_T[struck] += source.normal(0, part.values["size"], rows_T[struck].shape)
        return rows_T


@dataclass(frozen=True, eq=False)
class Spikes:
    """Isolated outliers.

    Parameters
    ----------
    samples : (k,) array of int
        Their indices.
    rows : (k,) array of int
        The row that explains most of each.
    """

    samples: NDArray[np.intp]
    rows: NDArray[np.intp]


def find_spikes(residuals: WhitenedResiduals) -> Spikes | str:
    """Return the isolated outliers, or why there are none, in one clause."""
    usable = residuals.channel_count > 0
    deviation = np.abs(row_deviations(residuals)) * usable[:, None]
    # The row that explains most, not the largest residual: noise of one row affects all.
    worst = deviation.argmax(axis=1)
    size = 50  # samples of a block, of which the median tells the local noise
    blocks = max(len(worst) // size, 1)
    local = noise_deviation(deviation[: blocks * size].reshape(blocks, -1, deviation.shape[1]), axis=1)
    samples = np.arange(len(worst))
    scale = np.maximum(local[np.minimum(samples // size, blocks - 1), worst], 1.0)
    far = deviation[samples, worst] > 5.0 * scale  # one of a million values of white noise is
    far &= _run_lengths(far) <= LONGEST_BURST
    if not far.any():
        return f"no reading is far off for at most {LONGEST_BURST} samples"
    if far.sum() > max(MINOR * usable.sum(), A_DOZEN):
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    return Spikes(np.flatnonzero(far), worst[far])


def without_spikes(residuals: WhitenedResiduals) -> WhitenedResiduals:
    """Return a residual in which the samples of isolated outliers do not count."""
    spikes = find_spikes(residuals)
    if isinstance(spikes, str):
        return residuals
    is_counted = residuals.is_counted.copy()
    is_counted[spikes.samples] = False
    return replace(residuals, is_counted=is_counted)


def _run_lengths(chosen: NDArray[np.bool_]) -> NDArray[np.intp]:
    """Return the length of the unbroken run of chosen samples that each sample is in, 0 outside."""
    starts = np.flatnonzero(np.diff(chosen, prepend=~chosen[:1]))
    lengths = np.diff(np.append(starts, len(chosen)))
    return np.asarray(np.repeat(lengths, lengths) * chosen)


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


def _contributions(
    residuals: WhitenedResiduals, spikes: Spikes, place: Place, flagged: NDArray[np.bool_]
) -> tuple[Contribution, ...]:
    parts = []
    for sensor, axis in place.contribution_keys():
        rows = [row for row in place.rows if axis is None or row % 3 == axis or sensor == SCALAR]
        own = spikes.rows if sensor == ALL else np.array(rows)[:, None]
        shift = residuals.row_shift_T[spikes.samples, own]
        size = float(np.sqrt(np.mean(shift**2)))
        values, errors = bursts_of(flagged)
        errors["size"] = size / float(np.sqrt(2 * shift.size))
        parts.append(Contribution(sensor, axis, "spikes", values | {"size": size}, errors))
    return tuple(parts)
