"""Timing jitter: a sensor whose true times of sampling scatter at random about its stamps.

A reading at t + δ differs by δ M db/dt: white noise with a variance for each sample, rank one along the path of the
field, growing with the square of its rate. With s² the floor, G the information of shifts of the sensor's readings, r
= M db/dt and t the score of such shifts,

    -2 ln L = n ln s² + Σ ln(1 + ρ g) + (S - Σ ρ q² / (1 + ρ g)) / s²,   g = rᵀGr, q = rᵀt, ρ = τ² / s²,

is least at the best s² and ρ; twice its fall from ρ = 0 is the gain. A delay that stays is taken off before.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.linalg import norm

from tam_calibration.effects.displaced import AgainstOthers
from tam_calibration.effects.effect import Covariates, Finding, FoundEffect, WhitenedResiduals
from tam_calibration.effects.excess_variance import ChannelMoments, best_excess, most_likely, relative_error
from tam_calibration.effects.grades import CERTAIN, NOTABLE
from tam_calibration.effects.motion import Statistic, is_chance, jumps, rates
from tam_calibration.effects.regularity import neighbour_covariance
from tam_calibration.effects.term import rows_of
from tam_calibration.model.fitted_effect import Contribution, FittedEffect
from tam_calibration.model.units import FloatArray

_HEAVIEST = 15.0
"""Kurtosis of the scatter at most: 9 for exponential waiting times, far more where only few samples are late."""


class TimingJitter(FoundEffect):
    """A scatter of the true times of sampling of one sensor."""

    name = "timing_jitter"

    def obstacle(self, covariates: Covariates) -> str | None:
        """Return that there is no continuous motion, or no other sensor to tell it, where that is so."""
        if covariates.sensor_count == 1:
            return "one sensor alone does not tell how fast the field changed when it was read"
        return jumps(covariates)

    def find(self, residuals: WhitenedResiduals) -> Finding | str:
        """Return the sensor whose samples scatter along the path of the field and by how much, or why none does."""
        paths = [_Path.of(residuals, sensor) for sensor in range(residuals.covariates.sensor_count)]
        path = min(paths, key=lambda one: one.profile(one.part) - one.profile(0.0))
        objection = path.objection()
        if objection is not None:
            return objection
        # Jitter has two numbers: its size, and the sensor.
        gain, noise = (
            path.profile(0.0) - path.profile(path.part),
            best_excess(ChannelMoments.of(residuals), residuals.covariates),
        )
        if noise is not None and noise.bic(path.channel_count) > gain - 2 * np.log(path.channel_count):
            return "noise that does not follow the path of the field explains as much"
        size = float(np.sqrt(path.part * path.floor(path.part)))
        spread = np.zeros((len(path.rate), 3 * len(paths) + 1))
        spread[:, 3 * path.sensor : 3 * path.sensor + 3] = size * path.rate
        values, errors = {"standard deviation": size}, {"standard deviation": size * path.relative_error() / 2}
        return Finding(
            FittedEffect(self.name, {}, (Contribution(path.sensor, None, "jitter", values, errors),)),
            gain=gain,
            parameter_count=2,
            spread_T=spread,
        )

    def put(self, rows_T: FloatArray, part: Contribution, run: Covariates, source: np.random.Generator) -> FloatArray:
        """Return the readings (N, n) of the n rows that a contribution acts on with the effect; see `FoundEffect`."""
        early = source.normal(0, part.values["standard deviation"], (len(rows_T), 1))
        return rows_T + early * (rates(run) @ run.errors.matrix.reshape(-1, 3).T)[:, rows_of(part, run)]


@dataclass(frozen=True, eq=False)
class _Path:
    """Residual of one sensor along the path of the field.

    Parameters
    ----------
    sensor : int
        Which one.
    rate : (N, 3) array
        r, T/s; zero in samples that do not count.
    beyond_T : (N, 3) array
        Its residual, a constant delay removed, tesla.
    whitening : (3, 3) array
        Of ``beyond_T``, as in ``AgainstOthers``.
    square, score : (N,) array
        g in 1/s² and q in 1/s.
    energy, channel_count : float
        S and n.
    """

    sensor: int
    rate: FloatArray
    beyond_T: FloatArray
    whitening: FloatArray
    square: FloatArray
    score: FloatArray
    energy: float
    channel_count: float

    @classmethod
    def of(cls, residuals: WhitenedResiduals, sensor: int) -> "_Path":
        """Return the residual of one sensor with its calibration and a constant delay fitted."""
        against, counted = AgainstOthers.of(residuals, sensor), residuals.is_counted
        rate = against.rate * counted[:, None]
        even = np.column_stack([np.ones(len(rate)), _unit(against.expected_T), _unit(rate)])[counted]
        values = np.linalg.lstsq(even.T @ even, even.T @ against.beyond_T[counted], rcond=None)[0]
        taken = np.zeros((len(rate), len(residuals.directions)))
        own = slice(3 * sensor, 3 * sensor + 3)
        taken[counted, own] = even @ values
        along, across = rate @ residuals.directions[own], np.sum(rate * residuals.row_slope[:, own], axis=1)
        across = np.where(np.isfinite(residuals.common_mode), across, 0.0)
        differential, common = residuals.channels_without(taken)
        return cls(
            sensor,
            rate,
            against.beyond_T - taken[:, own],
            against.whitening,
            np.sum(along**2, axis=1) + across**2,
            np.sum(along * differential, axis=1) + across * common,
            float(np.sum(differential[counted] ** 2) + np.sum(common[counted] ** 2)),
            float(residuals.channel_count[counted].sum()),
        )

    def floor(self, part: float) -> float:
        """Return s² at some ρ, in s²."""
        explained = np.sum(part * self.score**2 / (1 + part * self.square))
        return max(self.energy - float(explained), np.finfo(float).tiny) / self.channel_count

    def profile(self, part: float) -> float:
        """Return minus twice the log likelihood at some ρ, a constant left out."""
        return self.channel_count * float(np.log(self.floor(part))) + float(np.sum(np.log1p(part * self.square)))

    @cached_property
    def part(self) -> float:
        """The best ρ."""
        unit = max(float(np.mean(self.square)), np.finfo(float).tiny)
        return most_likely(lambda part: self.profile(part / unit)) / unit

    def relative_error(self) -> float:
        """Return the relative standard error of ρ, from the curvature of the likelihood."""
        return relative_error(lambda factor: self.profile(factor * self.part))

    def objection(self) -> str | None:
        """Return in one clause why the excess is no jitter, or None."""
        moves = self.square > 0
        if self.profile(self.part) >= self.profile(0.0) or not moves.any():
            return "no sensor scatters along the path of the field"
        along = self.score[moves] / np.sqrt(self.square[moves])
        size = float(np.mean(along**2))
        chance = CERTAIN * size / np.sqrt(len(along))
        if neighbour_covariance(along) > max(NOTABLE * (size - self.floor(self.part)), chance):
            return "what is off along the path of the field goes on from sample to sample"
        scatter = along / np.sqrt(1 + self.part * self.square[moves])
        if np.mean(scatter**4) > _HEAVIEST * np.mean(scatter**2) ** 2:
            return "what is off along the path of the field comes in few samples"
        if is_chance(self._statistic(), norm(self.rate, axis=1)):
            return "what is off has not the direction of the path of the field"
        return None

    def _statistic(self) -> Statistic:
        """Return the energy between sensors that jitter explains where each sample has the residual of another."""
        along, off = self.rate @ self.whitening, self.beyond_T @ self.whitening
        weighted = along * np.sqrt(self.part / (1 + self.part * np.sum(along**2, axis=1)))[:, None]
        return lambda dealt: float(np.sum(np.einsum("ni,ni->n", weighted, off[dealt]) ** 2))


def _unit(values: FloatArray) -> FloatArray:
    return values / max(float(np.abs(values).max()), np.finfo(float).tiny)
