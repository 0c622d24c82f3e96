"""Further variance: noise of an axis, a sensor or the scalar that exceeds that of the others, and of sampling times.

Variance a of directions F makes the covariance of a sample's whitened channels s² (I + ρ A Aᵀ), with ρ = a / s² and A
the derivatives of the channels by F. With s² at its maximum (a floor common to all, as no data sheet is exact), and
g and q the eigenvalues of AᵀA and the scores along its eigenvectors,

    -2 ln L = n ln s² + Σ ln(1 + ρ g) + (S - Σ ρ q² / (1 + ρ g)) / s²,

a maximum in ρ alone. Twice the logarithm of the likelihood against ρ = 0 is the gain: regressions are compared with the
same null model, white noise of one free variance.
"""

from collections.abc import Iterator, Sequence
from functools import cached_property

import numpy as np
from numpy.random import Generator

from tam_calibration.effects.effect import ALL, Contribution, Covariates, Finding, FoundEffect
from tam_calibration.effects.grades import LEAST_SAMPLES, MINOR
from tam_calibration.effects.residuals import WhitenedResiduals, places
from tam_calibration.effects.single_samples import without_spikes
from tam_calibration.effects.term import rows_of
from tam_calibration.model.array import Array
from tam_calibration.model.units import FloatArray

LARGEST_NOISE = 1.2
"""White noise over that of the data sheet, of all sensors or of the scalar, up to which it is no gap.

The sheet is merely inaccurate. Sensors of one array differ from each other by a smaller part of their variance.
"""


class Spread:
    """Further variance along directions that each sample has.

    Parameters
    ----------
    residuals : WhitenedResiduals
        Of N samples; those that count say what variance there is.
    rows : sequence of int
        The r rows that are shifted.
    directions : (N, r, p) or (r, p) array
        Shifts of these rows, tesla per unit.
    """

    def __init__(self, residuals: WhitenedResiduals, rows: Sequence[int], directions: FloatArray) -> None:
        index = np.flatnonzero(residuals.is_counted)
        self._stride = -(-len(index) // 16_384)  # as many samples tell a variance to one per cent
        index = index[:: self._stride]
        information, scores = residuals.normal(index, rows)
        along = directions if directions.ndim == 2 else directions[index]
        turned: FloatArray = np.swapaxes(along, -1, -2)
        values, vectors = np.linalg.eigh(turned @ information @ along)
        score = np.swapaxes(vectors, 1, 2) @ (turned @ scores[:, :, None])
        self._square, self._score_square = np.maximum(values, 0.0), score[:, :, 0] ** 2
        self._energy = float(residuals.energy[index].sum())
        self._channel_count = float(residuals.channel_count[index].sum())

    @cached_property
    def part(self) -> float:
        """The most likely ρ, to one per cent."""
        from scipy.optimize import minimize_scalar

        unit = float(self._square.max(initial=0.0))
        if unit == 0:
            return 0.0
        best = minimize_scalar(
            lambda log: self._profile(float(np.exp(log)) / unit),
            bounds=(-8.0, 16.0),  # from negligible to dominant
            method="bounded",
            options={"xatol": 1e-2},
        )
        return float(np.exp(best.x)) / unit

    @property
    def gain(self) -> float:
        """Twice the log likelihood ratio against no such variance, of all samples."""
        return self._stride * (self._profile(0.0) - self._profile(self.part))

    @property
    def variance(self) -> float:
        """The most likely variance a, in squares of the unit of the directions."""
        return self.part * self._floor(self.part)

    @property
    def relative_error(self) -> float:
        """Relative standard error of the standard deviation, from the curvature of the likelihood."""
        step = 0.2  # of the logarithm: within the parabola of the log-likelihood, far above rounding
        low, middle, high = (self._profile(self.part * float(np.exp(way))) for way in (-step, 0.0, step))
        return float(np.sqrt(2 * step**2 / max(low - 2 * middle + high, np.finfo(float).tiny))) / 2

    def _floor(self, part: float) -> float:
        explained = float(np.sum(part * self._score_square / (1 + part * self._square)))
        return max(self._energy - explained, np.finfo(float).tiny) / self._channel_count

    def _profile(self, part: float) -> float:
        """Return minus twice the log likelihood at some ρ, a constant left out."""
        return self._channel_count * float(np.log(self._floor(part))) + float(np.sum(np.log1p(part * self._square)))


def _deviation(sensor: int, axis: int | None, term: str, size: float, relative_error: float) -> Contribution:
    values, errors = {"standard deviation": size}, {"standard deviation": size * relative_error}
    return Contribution(sensor, axis, term, values, errors)


class NoiseExcess(FoundEffect):
    """More noise in some rows than in the others."""

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
            if _kurtosis(residuals.row_deviations[residuals.is_counted, row]) > 3.0:
                return "the excess comes as spikes"
        return best

    def _of_places(self, residuals: WhitenedResiduals) -> Iterator[Finding]:
        """Yield an excess at each place that may have one, with one variance for its rows or one for each."""
        covariates, row_count = residuals.covariates, residuals.row_slope.shape[1]
        single = np.array([Spread(residuals, [row], np.ones((1, 1))).part for row in range(row_count)])
        # A smaller excess is within the differences of sensors of a kind; the scalar's sheet may err the other way.
        least = MINOR * np.nan_to_num(stated_noise(covariates.array)) ** 2
        least[-1] *= (LARGEST_NOISE**4 - 1) / MINOR
        for place in places(covariates.sensor_count):
            rows = list(place.rows)
            # The floor and the excess must be separable.
            if len(rows) >= residuals.channel_count.mean() or (single[rows] <= least[rows] / 2).any():
                continue
            for weight in (np.ones(len(rows)), single[rows] / single[rows].max())[: len(rows)]:
                spread = Spread(residuals, rows, np.diag(np.sqrt(weight)))
                if (spread.part * weight < least[rows]).any():
                    continue
                variance = np.zeros(row_count)
                variance[rows] = spread.variance * weight
                is_alike = bool(np.ptp(weight) == 0)
                keys = zip(place.contribution_keys(is_alike), np.sqrt(variance[rows]).tolist(), strict=False)
                parts = [_deviation(*key, "noise", size, spread.relative_error) for key, size in keys]
                yield self.found(parts, spread.gain, 2 if is_alike else 1 + len(rows), variance=variance)

    def _shared(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the noise of all sensors beyond what a data sheet may be wrong by, or that there is none."""
        counted, noise_T = residuals.is_counted, residuals.covariates.array.vector_noise_T
        count = float(residuals.channel_count[counted].sum())
        variance = float(residuals.energy[counted].sum()) / count
        if variance <= LARGEST_NOISE**2 or noise_T is None:
            return "no row is noisier than the others, spikes left out"
        surplus, beyond = variance - 1, variance / LARGEST_NOISE**2
        size, relative_error = float(np.sqrt(surplus * np.mean(noise_T**2))), variance / surplus / np.sqrt(2 * count)
        parts = [_deviation(ALL, None, "noise", size, float(relative_error))]
        gain = count * (beyond - 1 - float(np.log(beyond)))
        return self.found(parts, gain, 1, variance=np.append(surplus * np.repeat(noise_T**2, 3), 0.0))

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        return rows_T + source.normal(0, part.values["standard deviation"], rows_T.shape)


class TimingJitter(FoundEffect):
    """A scatter of the true times of sampling of one sensor about its stamps.

    A reading at t + δ differs by δ M db/dt: white noise with a variance for each sample, along the path of the field
    and growing with the square of its rate.
    """

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the sensor whose samples scatter along the path of the field and by how much, or why none does."""
        rate = residuals.covariates.sensed_rate_T_per_s
        rows = [range(3 * sensor, 3 * sensor + 3) for sensor in range(residuals.covariates.sensor_count)]
        found = [Spread(residuals, own, rate[:, own, None]) for own in rows]
        sensor = int(np.argmax([one.gain for one in found]))
        best = found[sensor]
        if best.gain <= 0:
            return "no sensor scatters along the path of the field"
        size, spread = float(np.sqrt(best.variance)), np.zeros((len(rate), rate.shape[1] + 1))
        spread[:, rows[sensor]] = size * rate[:, rows[sensor]]
        parts = [_deviation(sensor, None, "jitter", size, best.relative_error)]
        # Jitter has two numbers: its size, and the sensor.
        return self.found(parts, best.gain, 2, spread_T=spread)

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        early = source.normal(0, part.values["standard deviation"], (len(rows_T), 1))
        return rows_T + early * run.sensed_rate_T_per_s[:, rows_of(part, run)]


def _kurtosis(deviation: FloatArray) -> float:
    """Return the excess kurtosis within blocks of 50 samples, so that intermittent noise has none."""
    blocks = max(1, len(deviation) // 50)
    square = deviation[: len(deviation) // blocks * blocks].reshape(blocks, -1) ** 2
    ratio = np.mean(square**2, axis=1) / np.maximum(np.mean(square, axis=1) ** 2, np.finfo(float).tiny)
    return float(np.mean(ratio)) - 3.0


def stated_noise(array: Array) -> FloatArray:
    """Return the noise (3K + 1,) that an array states of the rows, tesla; NaN where it states none.

    Parameters
    ----------
    array : Array
        With or without noise.
    """
    vector = np.full(array.sensor_count, np.nan) if array.vector_noise_T is None else array.vector_noise_T
    scalar = np.nan if array.scalar_noise_T is None else array.scalar_noise_T
    return np.append(np.repeat(vector, 3), scalar)
