"""Whether data contradict a prior, and the smallest change of one sensor that would explain it.

With d the difference of data and prior in the errors, V its covariance, P that of the prior and Σ that of both, what
counts follows from the fit of both, m, alone: V⁻¹ d = P⁻¹ (m - θ₀), and V⁻¹ = P⁻¹ - P⁻¹ Σ P⁻¹. A change E δ of three
errors of a sensor, δ normal with the covariance D of what may happen to it, explains the difference better than none by
the factor

    exp(½ qᵀ (M + D⁻¹)⁻¹ q) / √det(1 + D M),    q = Eᵀ V⁻¹ d,  M = Eᵀ V⁻¹ E,

the ratio of the evidences: a change that would explain little, or could be anything, is not preferred.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv

from tam_calibration.correction.update import KINDS
from tam_calibration.fit.posterior import Posterior
from tam_calibration.fit.prior import Prior
from tam_calibration.model.units import FloatArray, from_degrees, from_nanotesla

SIGNIFICANT = 1e-4
"""Probability of a difference below which data and prior contradict: one false alarm in ten thousand updates."""

_LEAST_TOLD = 0.01
"""Information of the data over that of the prior above which a direction counts: in others they cannot contradict."""

_SIZES = np.array([1e-3, from_degrees(0.1), from_nanotesla(30.0), from_degrees(0.1)])
"""Standard deviation of what may happen to a sensor, by kind, SI: each is some 30 to 90 nT in the field of the Earth,
as of a tool nearby, a knock or an amplifier; ten times as much is found and told as well."""

_PLAUSIBLE = 0.05
"""Probability from which a rival is told, and the prior widened for it too."""


@dataclass(frozen=True, eq=False)
class Difference:
    """Data against a prior, both summed up in the fit of both.

    Parameters
    ----------
    score : (12 K,) array
        V⁻¹ d.
    information : (12 K, 12 K) array
        V⁻¹.
    chi_square : float
        dᵀ V⁻¹ d over the directions that the data tell.
    freedom : int
        Their number.
    """

    score: FloatArray
    information: FloatArray
    chi_square: float
    freedom: int

    @classmethod
    def of(cls, prior: Prior, posterior: Posterior) -> "Difference":
        """Return the difference of a prior and what the data told beside it."""
        comparable, derivative = prior.in_convention(posterior.errors)
        covariance = derivative @ posterior.covariance @ derivative.T
        distance = (comparable.to_vector() - prior.errors.to_vector()).ravel()
        score = prior.precision @ distance
        # In coordinates in which the prior has unit variance the posterior has 1 / (1 + λ), λ the data's information.
        values, vectors = np.linalg.eigh(prior.precision * np.outer(*2 * (prior.scale,)))
        known = values > 0.5 / len(values)
        root = vectors[:, known] * np.sqrt(values[known]) / prior.scale[:, None]
        left, turns = np.linalg.eigh(root.T @ covariance @ root)
        gain = 1 / np.clip(left, 1e-12, 1.0) - 1
        along = turns.T @ (root.T @ distance)
        told = gain > _LEAST_TOLD
        chi_square = float(np.sum(along[told] ** 2 * (1 + 1 / gain[told])))
        return cls(score, prior.precision - prior.precision @ covariance @ prior.precision, chi_square, int(told.sum()))
