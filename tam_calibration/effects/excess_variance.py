"""Rows that are noisier than the others, from the covariance of the whitened channels.

Extra variance q of rows J makes the covariance of a sample's whitened channels s² I + A q Aᵀ, with A the derivatives
of the channels by the rows. With s² at its maximum (a floor common to all, as a data sheet is never exact) and the
determinant and inverse by Woodbury's identity,

    -2 ln L = n ln s² + Σ ln det(I + a G) + (S - Σ t (I + a G)⁻¹ a t) / s²,   a = q / s², G = AᵀA, t = Aᵀw,

a maximum in one or a few variances. G depends on the direction of the field through the common mode, so the sums run
over cells of directions, in which G is taken at its mean. Twice the logarithm of the likelihood against a = 0 is the
gain: regressions are compared with the same null model, white noise of one free variance.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.grades import MINOR
from tam_calibration.effects.term import Place, WhitenedResiduals, places, row_scores
from tam_calibration.model.fitted_effect import SCALAR
from tam_calibration.model.units import FloatArray

_CELLS = 48
"""Cells of directions on half the sphere, twenty degrees wide, in each of which AᵀA is averaged.

Their number grows with χ²/n of the residual, as the error of the average does.
"""

_MOST_CELLS = 4096
"""Cells at most, two degrees wide: enough for noise thirty times as large as the others'."""

LARGEST_NOISE = 1.2
"""White noise over that of the data sheet, of all sensors or of the scalar, up to which it is no gap.

The sheet is merely inaccurate. Sensors of one array differ from each other by a smaller part of their variance.
"""

_LOG_RANGE = (-8.0, 16.0)
"""Search range of the logarithm of excess variance over the floor, from negligible to dominant."""

_STEP = 0.2
"""Step of that logarithm for the curvature of the log-likelihood: within its parabola, far above rounding."""


@dataclass(frozen=True, eq=False)
class ChannelMoments:
    """Second moments of the whitened channels that the likelihood of excess noise needs, by cells of directions.

    Parameters
    ----------
    count : (C,) array
        Samples of each cell.
    gram : (C, R, R) array
        Mean AᵀA.
    score : (C, R, R) array
        Sum of t tᵀ.
    energy, channel_count : float
        Of all samples that count.
    """

    count: FloatArray
    gram: FloatArray
    score: FloatArray
    energy: float
    channel_count: float

    @classmethod
    def of(cls, residuals: WhitenedResiduals) -> "ChannelMoments":
        """Return the moments of the samples that count."""
        counted = residuals.is_counted
        cell = _cells(residuals)[counted]
        scores, slope = row_scores(residuals)[counted], residuals.row_slope[counted]
        slope = np.where(np.isfinite(residuals.common_mode[counted])[:, None], slope, 0.0)
        row_count = slope.shape[1]
        coupling = np.zeros((row_count, row_count))
        coupling[:-1, :-1] = residuals.directions @ residuals.directions.T
        order = np.argsort(cell, kind="stable")
        starts = np.unique(cell[order], return_index=True)[1]
        groups = np.split(order, starts[1:])
        count = np.array([len(group) for group in groups], dtype=float)
        gram = np.array([coupling + slope[group].T @ slope[group] / len(group) for group in groups])
        score = np.array([scores[group].T @ scores[group] for group in groups])
        return cls(
            count, gram, score, float(residuals.energy[counted].sum()), float(residuals.channel_count[counted].sum())
        )

    @property
    def row_count(self) -> int:
        """Number of rows R."""
        return int(self.gram.shape[1])

    @property
    def sample_count(self) -> float:
        """Number of samples that count."""
        return float(self.count.sum())

    @cached_property
    def without(self) -> float:
        """Minus twice the log likelihood of white noise of one free variance, a constant left out."""
        return self.channel_count * float(np.log(self.energy / self.channel_count)) + self.channel_count

    def profile(self, rows: tuple[int, ...], part: FloatArray) -> tuple[float, float]:
        """Return minus twice the log likelihood with excess of rows, relative to the floor, and the floor s².

        Parameters
        ----------
        rows : tuple of int
            J rows with excess noise.
        part : (J,) array
            Excess variance of each row over the floor s², T².
        """
        if len(rows) == 1:
            inner = 1 + part[0] * self.gram[:, rows[0], rows[0]]
            explained = float((part[0] * self.score[:, rows[0], rows[0]] / inner).sum())
            return self._likelihood(np.log(inner), explained)
        chosen = np.ix_(range(len(self.count)), rows, rows)
        root = np.sqrt(part)
        gram = root[:, None] * self.gram[chosen] * root
        score = root[:, None] * self.score[chosen] * root
        inner = np.eye(len(rows)) + gram
        _, log_determinant = np.linalg.slogdet(inner)
        explained = float(np.trace(np.linalg.solve(inner, score), axis1=1, axis2=2).sum())
        return self._likelihood(log_determinant, explained)

    def _likelihood(self, log_determinant: FloatArray, explained: float) -> tuple[float, float]:
        """Return minus twice the log likelihood, and the floor s² that the explained energy leaves."""
        floor = max(self.energy - explained, np.finfo(float).tiny) / self.channel_count
        n = self.channel_count
        return float(n * np.log(floor) + self.count @ log_determinant + n), floor

    def relative_error(self, excess: "Excess") -> float:
        """Return the relative standard error of an excess variance, from the curvature of the likelihood."""
        return relative_error(lambda factor: self.profile(excess.place.rows, factor * excess.part)[0])


@dataclass(frozen=True, eq=False)
class Excess:
    """Excess noise variance of a place.

    Parameters
    ----------
    place : Place
        Where.
    part : (J,) array
        Excess variance of each row over the floor s², T².
    floor : float
        s².
    gain : float
        Twice the log likelihood ratio against white noise.
    parameter_count : int
        Variances and the choice of the place.
    """

    place: Place
    part: FloatArray
    floor: float
    gain: float
    parameter_count: int

    @property
    def variance_T2(self) -> FloatArray:
        """(J,) excess variance of the rows, T²."""
        return self.part * self.floor

    def bic(self, channel_count: float) -> float:
        """Return the evidence, in so many channels."""
        return self.gain - self.parameter_count * float(np.log(channel_count))


def best_excess(moments: ChannelMoments, covariates: Covariates) -> Excess | None:
    """Return the excess with the best BIC among all places, None where none has any.

    Parameters
    ----------
    moments : ChannelMoments
        Second moments of the whitened residuals.
    covariates : Covariates
        Number of sensors, and the noise that the array states.
    """
    stated = stated_variance(covariates)
    single = np.array([_scaled(moments, (row,), np.ones(1))[0] for row in range(moments.row_count)])
    best, best_bic = None, 0.0
    for place in places(covariates.sensor_count):
        rows = list(place.rows)
        if len(rows) * moments.sample_count >= moments.channel_count:
            continue  # the floor and the excess would not be separable
        # A smaller excess is within the differences of sensors of a kind; the scalar's sheet may err the other way.
        least = (LARGEST_NOISE**4 - 1 if place.sensor == SCALAR else MINOR) * stated[rows]
        if (single[rows] <= least / 2).any():
            continue
        for weight in (np.ones(len(rows)), single[rows] / single[rows].max())[: len(rows)]:
            part = single[rows] if len(rows) == 1 else _scaled(moments, place.rows, weight)
            if (part < least).any():
                continue
            value, floor = moments.profile(place.rows, part)
            count = 1 + (1 if weight.min() == 1 else len(rows))
            excess = Excess(place, part, floor, moments.without - value, count)
            bic = excess.bic(moments.channel_count)
            if bic > best_bic:
                best, best_bic = excess, bic
    return best


def _scaled(moments: ChannelMoments, rows: tuple[int, ...], weight: FloatArray) -> FloatArray:
    """Return the most likely excess of rows over the floor with the given proportions."""
    largest = float(moments.gram[:, rows, rows].max())
    if largest == 0:
        return np.zeros(len(rows))
    return most_likely(lambda part: moments.profile(rows, part / largest * weight)[0]) / largest * weight


def most_likely(profile: Callable[[float], float]) -> float:
    """Return the variance ratio that minimises minus twice a log-likelihood, to one per cent."""
    from scipy.optimize import minimize_scalar

    done = minimize_scalar(
        lambda log: profile(float(np.exp(log))), bounds=_LOG_RANGE, method="bounded", options={"xatol": 1e-2}
    )
    return float(np.exp(done.x))


def relative_error(profile: Callable[[float], float]) -> float:
    """Return the relative standard error of a parameter, from minus twice the log-likelihood around its best value."""
    low, middle, high = (profile(float(np.exp(step))) for step in (-_STEP, 0.0, _STEP))
    return float(np.sqrt(2 * _STEP**2 / max(low - 2 * middle + high, np.finfo(float).tiny)))


def stated_variance(covariates: Covariates) -> FloatArray:
    """Return the (3K + 1,) variance of the rows as the array states it, T²."""
    stated = covariates.array.vector_noise_T
    vector = np.zeros(covariates.scalar_row) if stated is None else np.repeat(stated, 3) ** 2
    return np.append(vector, (covariates.array.scalar_noise_T or 0.0) ** 2)


def _cells(residuals: WhitenedResiduals) -> NDArray[np.intp]:
    """Return the cell of each sample: half the sphere in equal parts, and one for samples without reference."""
    from scipy.spatial import cKDTree

    counted = residuals.is_counted
    excess = residuals.energy[counted].sum() / max(residuals.channel_count[counted].sum(), 1)
    count = int(np.clip(_CELLS * excess, _CELLS, _MOST_CELLS))
    index = np.arange(count) + 0.5
    height = 1 - index / count
    azimuth = np.pi * (1 + np.sqrt(5)) * index
    level = np.sqrt(1 - height**2)
    centers = np.stack([level * np.cos(azimuth), level * np.sin(azimuth), height], axis=1)
    direction = residuals.covariates.field_T / residuals.covariates.intensity_T[:, None]
    nearest = cKDTree(np.concatenate([centers, -centers])).query(direction)[1] % count
    return np.where(np.isfinite(residuals.common_mode), nearest, count)
