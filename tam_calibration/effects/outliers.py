"""Outliers: single readings, or bursts of a few, that are far off while their neighbours are not.

The gain is that of the mean-shift model (Cook and Weisberg 1982): each flagged sample has shifts of its own. They are
penalised by their code length: k positions among N samples take ln C(N, k) nats and a shift of variance v ½ ln v,
where BIC takes ½ ln n per parameter; that is about two parameters for a single spike, fewer for each of many.

Such effects are simulated as bursts of samples that something strikes at random times.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.random import Generator
from numpy.typing import NDArray

from tam_calibration.core.noise import noise_deviation
from tam_calibration.effects.effect import ALL, Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import LONGEST_BURST, MINOR
from tam_calibration.effects.residuals import Place, WhitenedResiduals, places
from tam_calibration.model.exceptions import InputError
from tam_calibration.model.units import FloatArray

A_DOZEN = 12
"""Single readings that are no noise, whatever part of a short recording they are: a sixth of 72 poses."""


class Outliers(FoundEffect):
    """Spikes in single readings."""

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the spikes, flagged, or why there is none."""
        rows = find_spikes(residuals)
        if isinstance(rows, str):
            return rows
        flagged = rows >= 0
        samples = np.flatnonzero(flagged)
        rest = ~flagged & (residuals.channel_count > 0)
        floor = float(residuals.energy[rest].sum() / residuals.channel_count[rest].sum())
        place, saved, value_cost = _best_place(residuals, samples, floor)
        parts = []
        for sensor, axis in place.contribution_keys():
            own = rows[samples] if sensor == ALL else [[row] for row in place.rows if axis is None or row % 3 == axis]
            shift = residuals.row_shift_T[samples, own]
            size = float(np.sqrt(np.mean(shift**2)))
            values, errors = bursts_of(flagged)
            errors["size"] = size / float(np.sqrt(2 * shift.size))
            parts.append(Contribution(sensor, axis, "spikes", values | {"size": size}, errors))
        nats = position_nats(len(flagged), len(samples)) + value_cost / 2
        return self.of_samples(parts, residuals, flagged, saved, 1, nats)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        struck = np.unique(drawn_bursts(part, len(rows_T), source))
        rows_T[struck] += source.normal(0, part.values["size"], rows_T[struck].shape)
        return rows_T


def find_spikes(residuals: WhitenedResiduals) -> NDArray[np.intp] | str:
    """Return the row that explains most of each isolated outlier and -1 at other samples (N,), or why there is none."""
    from scipy.ndimage import label

    usable = residuals.channel_count > 0
    deviation = np.abs(residuals.row_deviations) * usable[:, None]
    # The row that explains most, not the largest residual: noise of one row affects all.
    worst = deviation.argmax(axis=1)
    size = 50  # samples of a block, of which the median tells the local noise
    blocks = max(len(worst) // size, 1)
    local = noise_deviation(deviation[: blocks * size].reshape(blocks, -1, deviation.shape[1]), axis=1)
    samples = np.arange(len(worst))
    scale = np.maximum(local[np.minimum(samples // size, blocks - 1), worst], 1.0)
    far = deviation[samples, worst] > 5.0 * scale  # one of a million values of white noise is
    runs, _ = label(far)
    far &= np.bincount(runs)[runs] <= LONGEST_BURST
    if not far.any():
        return f"no reading is far off for at most {LONGEST_BURST} samples"
    if far.sum() > max(MINOR * usable.sum(), A_DOZEN):
        return f"{far.sum()} of {usable.sum()} samples are too many for spikes"
    return np.where(far, worst, -1)


def without_spikes(residuals: WhitenedResiduals) -> WhitenedResiduals:
    """Return a residual in which the samples of isolated outliers do not count."""
    rows = find_spikes(residuals)
    return residuals if isinstance(rows, str) else replace(residuals, is_counted=residuals.is_counted & (rows < 0))


def _best_place(residuals: WhitenedResiduals, samples: NDArray[np.intp], floor: float) -> tuple[Place, float, float]:
    """Return where the spikes are, the energy that they explain there, and twice the nats of their values.

    Spikes are Gaussian of one variance v of the whitened shift: twice the log likelihood ratio against the floor is
    the energy less d (1 + ln v) for each of d shifts, at the best v.
    """
    found = []
    for place, energy, freedom, choices in _offers(residuals, samples):
        total = len(samples) * freedom
        variance = max(energy / floor / total, 1.0)
        cost = total * float(1 + np.log(variance)) + 2 * len(samples) * float(np.log(choices))
        found.append((place, energy, cost))
    return max(found, key=lambda item: item[1] / floor - item[2])


def _offers(residuals: WhitenedResiduals, samples: NDArray[np.intp]) -> Iterator[tuple[Place, float, int, int]]:
    """Yield places with the energy that spikes explain there, the shifts of a sample, and among how many rows each is.

    Of several sensors, spikes may be in all rows at once, or each in a row of its own.
    """
    count = residuals.covariates.sensor_count
    for place in places(count)[count == 1 :]:
        yield place, float(residuals.explained_energy(samples, place.rows).sum()), len(place.rows), 1
    if count > 1:
        whole, channels = Place(ALL, tuple(range(3 * count))), int(np.median(residuals.channel_count[samples]))
        yield whole, float(residuals.energy[samples].sum()), channels, 1
        single = residuals.row_deviations[samples]
        yield whole, float(np.max(single**2, axis=1).sum()), 1, 3 * count + 1


def drawn_bursts(part: Contribution, sample_count: int, generator: Generator) -> NDArray[np.intp]:
    """Draw bursts of samples; return the samples of each, (bursts, samples of a burst): at the end the last repeats.

    Parameters
    ----------
    part : Contribution
        With the ``rate``, the part of all samples that is struck, and the ``burst`` in samples, by default one.
    sample_count : int
        Of the run.
    generator : numpy.random.Generator
        Source of the random numbers.

    Raises
    ------
    InputError
        When the rate is no part, or the burst longer than the run.
    """
    rate, burst = part.values["rate"], samples_in(part, "burst", sample_count)
    if not 0 <= rate <= 1:
        raise InputError(f"the rate of {part.term} must be a part of all samples, 0 to 1, not {rate:g}")
    starts = np.flatnonzero(generator.random(sample_count) < rate / burst)
    return np.asarray(np.minimum(starts[:, None] + np.arange(burst), sample_count - 1))


def samples_in(part: Contribution, name: str, sample_count: int) -> int:
    """Return a number of samples, at least and by default one, that a contribution states.

    Parameters
    ----------
    part : Contribution
        Of the effect.
    name : str
        Of the value.
    sample_count : int
        Of the run, which the number must not exceed.

    Raises
    ------
    InputError
        When it does, or is negative.
    """
    number = part.values.get(name, 1.0)
    if not 0 <= number <= sample_count:
        raise InputError(
            f"the {name} of {part.term} must be at most the {sample_count} samples of the run, not {number:g}"
        )
    return max(1, round(number))


def bursts_of(struck: NDArray[np.bool_]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the part of the samples (N,) that are struck, how many follow each other, and standard errors, by name."""
    samples = np.flatnonzero(struck)
    rate, runs = len(samples) / len(struck), 1 + int(np.sum(np.diff(samples) > 1))
    error = float(np.sqrt(rate * (1 - rate) / len(struck)))
    return {"rate": rate, "burst": len(samples) / runs}, {"rate": error}


def position_nats(sample_count: int, chosen: int) -> float:
    """Return ln C(N, k), the code length of k flagged samples among N, in nats."""
    from scipy.special import gammaln

    return float(gammaln(sample_count + 1) - gammaln(chosen + 1) - gammaln(sample_count - chosen + 1))
