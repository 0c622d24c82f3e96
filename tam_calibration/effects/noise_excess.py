"""Noise excess: an axis, a sensor or the scalar magnetometer that is noisier than the others."""

from collections.abc import Iterator

import numpy as np

from tam_calibration.effects.effect import ALL, Contribution, Covariates, Finding, FittedEffect, FoundEffect
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR
from tam_calibration.effects.spikes import without_spikes
from tam_calibration.effects.spread import LARGEST_NOISE, Spread
from tam_calibration.effects.term import Place, WhitenedResiduals, places, row_deviations
from tam_calibration.model.units import FloatArray

_HEAVY = 3.0
"""Excess kurtosis, within blocks of samples, from which an excess consists of spikes."""

_BLOCK = 50
"""Samples of a block, within which the variance is taken as constant."""


class NoiseExcess(FoundEffect):
    """More noise in some rows than in the others."""

    name = "noise_excess"

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the rows with more noise and how much, or why there is none."""
        residuals = without_spikes(residuals)
        if residuals.is_counted.sum() < LEAST_SAMPLES:
            return f"a variance needs {LEAST_SAMPLES} samples or more, spikes left out"
        best, best_bic = self._shared(residuals), 0.0
        for finding in self._of_places(residuals):
            bic = finding.gain - finding.parameter_count * float(np.log(residuals.channel_count.sum()))
            if bic > best_bic:
                best, best_bic = finding, bic
        if isinstance(best, Finding) and best.variance is not None:
            row = int(np.argmax(best.variance * residuals.row_information.mean(axis=0)))
            if _kurtosis(row_deviations(residuals)[residuals.is_counted, row]) > _HEAVY:
                return "the excess comes as spikes"
        return best

    def _of_places(self, residuals: WhitenedResiduals) -> Iterator[Finding]:
        """Yield an excess at each place that may have one, with one variance for its rows or one for each."""
        covariates, row_count = residuals.covariates, residuals.row_slope.shape[1]
        single = np.array([Spread.of(residuals, [row], np.ones((1, 1))).part for row in range(row_count)])
        # A smaller excess is within the differences of sensors of a kind; the scalar's sheet may err the other way.
        least = MINOR * _stated_variance(covariates)
        least[-1] *= (LARGEST_NOISE**4 - 1) / MINOR
        for place in places(covariates.sensor_count):
            rows = list(place.rows)
            # The floor and the excess must be separable.
            if len(rows) >= residuals.channel_count.mean() or (single[rows] <= least[rows] / 2).any():
                continue
            for weight in (np.ones(len(rows)), single[rows] / single[rows].max())[: len(rows)]:
                spread = Spread.of(residuals, rows, np.diag(np.sqrt(weight)))
                if (spread.part * weight >= least[rows]).all():
                    yield self._finding(place, spread, weight, row_count)

    def _finding(self, place: Place, spread: Spread, weight: FloatArray, row_count: int) -> Finding:
        variance = np.zeros(row_count)
        variance[list(place.rows)] = spread.variance * weight
        is_alike = bool(np.ptp(weight) == 0)
        sizes, parts = (spread.size * np.sqrt(weight)).tolist(), []
        for (sensor, axis), size in zip(place.contribution_keys(is_alike), sizes, strict=False):
            values, errors = {"standard deviation": size}, {"standard deviation": size * spread.relative_error}
            parts.append(Contribution(sensor, axis, "noise", values, errors))
        count = 1 + (1 if is_alike else len(weight))
        return Finding(FittedEffect(self.name, {}, tuple(parts)), spread.gain, count, variance=variance)

    def _shared(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the noise of all sensors beyond what a data sheet may be wrong by, or that there is none."""
        counted, noise_T = residuals.is_counted, residuals.covariates.array.vector_noise_T
        count = float(residuals.channel_count[counted].sum())
        variance = float(residuals.energy[counted].sum()) / count
        if variance <= LARGEST_NOISE**2 or noise_T is None:
            return "no row is noisier than the others, spikes left out"
        surplus, beyond = variance - 1, variance / LARGEST_NOISE**2
        size = float(np.sqrt(surplus * np.mean(noise_T**2)))
        error = size * variance / surplus / float(np.sqrt(2 * count))
        values, errors = {"standard deviation": size}, {"standard deviation": error}
        return Finding(
            FittedEffect(self.name, {}, (Contribution(ALL, None, "noise", values, errors),)),
            gain=count * (beyond - 1 - float(np.log(beyond))),
            parameter_count=1,
            variance=np.append(surplus * np.repeat(noise_T**2, 3), 0.0),
        )

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        return rows_T + source.normal(0, part.values["standard deviation"], rows_T.shape)


def _kurtosis(deviation: FloatArray) -> float:
    """Return the excess kurtosis within blocks of samples, so that intermittent noise has none."""
    blocks = max(1, len(deviation) // _BLOCK)
    square = deviation[: len(deviation) // blocks * blocks].reshape(blocks, -1) ** 2
    ratio = np.mean(square**2, axis=1) / np.maximum(np.mean(square, axis=1) ** 2, np.finfo(float).tiny)
    return float(np.mean(ratio)) - 3.0


def _stated_variance(covariates: Covariates) -> FloatArray:
    """Return the (3K + 1,) variance of the rows as the array states it, T²."""
    stated = covariates.array.vector_noise_T
    vector = np.zeros(covariates.scalar_row) if stated is None else np.repeat(stated, 3) ** 2
    return np.append(vector, (covariates.array.scalar_noise_T or 0.0) ** 2)
