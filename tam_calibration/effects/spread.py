"""Further variance of the rows along given directions: its size, and the evidence for it.

Variance a of directions F makes the covariance of a sample's whitened channels s² (I + ρ A Aᵀ), with ρ = a / s² and A
the derivatives of the channels by F. With s² at its maximum (a floor common to all, as no data sheet is exact), and
g and q the eigenvalues of AᵀA and the scores along its eigenvectors,

    -2 ln L = n ln s² + Σ ln(1 + ρ g) + (S - Σ ρ q² / (1 + ρ g)) / s²,

a maximum in ρ alone. Twice the logarithm of the likelihood against ρ = 0 is the gain: regressions are compared with the
same null model, white noise of one free variance.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tam_calibration.effects.term import WhitenedResiduals, normal_of
from tam_calibration.model.units import FloatArray

LARGEST_NOISE = 1.2
"""White noise over that of the data sheet, of all sensors or of the scalar, up to which it is no gap.

The sheet is merely inaccurate. Sensors of one array differ from each other by a smaller part of their variance.
"""

_MOST = 16_384
"""Samples at most from which a variance is estimated: to one per cent."""

_LOG_RANGE = (-8.0, 16.0)
"""Search range of the logarithm of the variance over the floor, from negligible to dominant."""

_STEP = 0.2
"""Step of that logarithm for the curvature of the log-likelihood: within its parabola, far above rounding."""


@dataclass(frozen=True, eq=False)
class Spread:
    """Further variance along directions that each sample has.

    Parameters
    ----------
    square, score : (N, p) array
        g and q, per unit of the directions.
    energy, channel_count : float
        S and n.
    stride : int
        Every so many samples are taken.
    """

    square: FloatArray
    score: FloatArray
    energy: float
    channel_count: float
    stride: int

    @classmethod
    def of(cls, residuals: WhitenedResiduals, rows: Sequence[int], directions: FloatArray) -> "Spread":
        """Return what the samples that count say of variance along directions.

        Parameters
        ----------
        residuals : WhitenedResiduals
            Of N samples.
        rows : sequence of int
            The r rows that are shifted.
        directions : (N, r, p) or (r, p) array
            Shifts of these rows, tesla per unit.
        """
        index = np.flatnonzero(residuals.is_counted)
        stride = -(-len(index) // _MOST)
        index = index[::stride]
        information, scores = normal_of(residuals, index, rows)
        along = directions if directions.ndim == 2 else directions[index]
        turned: FloatArray = np.swapaxes(along, -1, -2)
        values, vectors = np.linalg.eigh(turned @ information @ along)
        score = (turned @ scores[:, :, None])[:, :, 0]
        return cls(
            np.maximum(values, 0.0),
            (np.swapaxes(vectors, 1, 2) @ score[:, :, None])[:, :, 0],
            float(residuals.energy[index].sum()),
            float(residuals.channel_count[index].sum()),
            stride,
        )

    @cached_property
    def part(self) -> float:
        """The most likely ρ, to one per cent."""
        from scipy.optimize import minimize_scalar

        unit = float(self.square.max(initial=0.0))
        if unit == 0:
            return 0.0
        best = minimize_scalar(
            lambda log: self._profile(float(np.exp(log)) / unit),
            bounds=_LOG_RANGE,
            method="bounded",
            options={"xatol": 1e-2},
        )
        return float(np.exp(best.x)) / unit

    @property
    def gain(self) -> float:
        """Twice the log likelihood ratio against no such variance, of all samples."""
        return self.stride * (self._profile(0.0) - self._profile(self.part))

    @property
    def variance(self) -> float:
        """The most likely variance a, in squares of the unit of the directions."""
        return self.part * self._floor(self.part)

    @property
    def size(self) -> float:
        """Its root, the standard deviation."""
        return float(np.sqrt(self.variance))

    @property
    def relative_error(self) -> float:
        """Relative standard error of the standard deviation, from the curvature of the likelihood."""
        low, middle, high = (self._profile(self.part * float(np.exp(step))) for step in (-_STEP, 0.0, _STEP))
        return float(np.sqrt(2 * _STEP**2 / max(low - 2 * middle + high, np.finfo(float).tiny))) / 2

    def _floor(self, part: float) -> float:
        explained = float(np.sum(part * self.score**2 / (1 + part * self.square)))
        return max(self.energy - explained, np.finfo(float).tiny) / self.channel_count

    def _profile(self, part: float) -> float:
        """Return minus twice the log likelihood at some ρ, a constant left out."""
        return self.channel_count * float(np.log(self._floor(part))) + float(np.sum(np.log1p(part * self.square)))
