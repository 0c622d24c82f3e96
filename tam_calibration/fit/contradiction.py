"""Whether data contradict a prior, and the smallest change of one sensor that would explain it.

With d the difference of data and prior in the errors, V its covariance, P that of the prior and Σ that of both, what
counts follows from the fit of both, m, alone: V⁻¹ d = P⁻¹ (m - θ₀), and V⁻¹ = P⁻¹ - P⁻¹ Σ P⁻¹. A change E δ of three
errors of a sensor, δ normal with the covariance D of what may happen to it, explains the difference better than none by
the factor

    exp(½ qᵀ (M + D⁻¹)⁻¹ q) / √det(1 + D M),    q = Eᵀ V⁻¹ d,  M = Eᵀ V⁻¹ E,

the ratio of the evidences: a change that would explain little, or could be anything, is not preferred.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.linalg import inv, slogdet

from tam_calibration.correction.update import KINDS
from tam_calibration.fit.posterior import Posterior
from tam_calibration.fit.prior import Prior
from tam_calibration.model.units import FloatArray, from_nanotesla

SIGNIFICANT = 1e-4
"""Probability of a difference below which data and prior contradict: one false alarm in ten thousand updates."""

_CONVINCING = np.log(1e4)
"""Logarithm of the evidence of a change from which it contradicts, however little it is of the whole difference: by
chance a given one is convincing at most once in ten thousand updates."""

_LEAST_TOLD = 0.01
"""Information of the data over that of the prior above which a direction counts: in others they cannot contradict."""

_SIZES_T = from_nanotesla(np.array([10.0, 100.0, 1e3, 1e4]))
"""Standard deviations of what may happen to a sensor, from a screwdriver at a metre to an amplifier that broke: as a
bias, and as a scale factor or angle times the field."""

_MOST_CHANGES = 3
"""Of one kind of one sensor, found one after the other: where more moved, the whole array has."""

_PLAUSIBLE = 0.05
"""Probability from which a change is told beside the most probable one, and the prior widened for it too."""


@dataclass(frozen=True, eq=False)
class Change:
    """Three errors of one sensor that may have moved.

    Parameters
    ----------
    kind : str
        One of ``KINDS``.
    sensor : int
        From 0.
    directions : (12 K, 3) array
        E: changes of all errors, in the convention of the prior, by its three.
    variance : (3,) array
        Of what may happen to them: the diagonal of D.
    probability : float
        Among all changes.
    estimate, standard_errors : (3,) array
        What the difference tells of it.
    """

    kind: str
    sensor: int
    directions: FloatArray
    variance: FloatArray
    probability: float = 0.0
    estimate: FloatArray = field(default_factory=lambda: np.zeros(3))
    standard_errors: FloatArray = field(default_factory=lambda: np.full(3, np.inf))


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
        # Where the prior has unit variance, that of both is 1 / (1 + λ), λ the information of the data.
        left, turns = np.linalg.eigh(prior.whitening.T @ covariance @ prior.whitening)
        gain = 1 / np.clip(left, np.finfo(float).eps, 1.0) - 1
        along = turns.T @ (prior.whitening.T @ distance)
        told = gain > _LEAST_TOLD
        chi_square = float(np.sum(along[told] ** 2 * (1 + 1 / gain[told])))
        information = prior.precision - prior.precision @ covariance @ prior.precision
        return cls(prior.precision @ distance, information, chi_square, int(told.sum()))

    @property
    def probability(self) -> float:
        """Of a χ² as large by chance."""
        return probability_of(self.chi_square, self.freedom)

    def evidence(self, change: Change) -> float:
        """Return the logarithm of the factor by which a change explains it better than none."""
        score, information = self._along(change)
        gain = float(score @ np.linalg.solve(information + np.diag(1 / change.variance), score))
        size = slogdet(np.eye(len(score)) + change.variance[:, None] * information)[1]
        return (gain - float(size)) / 2

    def estimated(self, change: Change) -> Change:
        """Return a change with what the difference tells of it."""
        score, information = self._along(change)
        covariance = inv(information + np.diag(1 / change.variance))
        return replace(change, estimate=covariance @ score, standard_errors=np.sqrt(np.diag(covariance)))

    def without(self, change: Change) -> "Difference":
        """Return the difference that is left where a change explains its part."""
        score, information = self._along(change)
        kept = inv(information + np.diag(1 / change.variance))
        reached = self.information @ change.directions
        return Difference(
            self.score - reached @ kept @ score,
            self.information - reached @ kept @ reached.T,
            self.chi_square - float(score @ kept @ score),
            self.freedom,
        )

    def _along(self, change: Change) -> tuple[FloatArray, FloatArray]:
        directions = change.directions
        return directions.T @ self.score, directions.T @ self.information @ directions


def probability_of(chi_square: float, freedom: int) -> float:
    """Return the probability of a χ² as large by chance; 1 where nothing is free."""
    from scipy.special import chdtrc

    return float(chdtrc(freedom, chi_square)) if freedom else 1.0


def changes_that_explain(difference: Difference, prior: Prior) -> list[list[Change]]:
    """Return the changes that remove a contradiction, each with its plausible rivals after it, the strongest first."""
    found: list[list[Change]] = []
    candidates = _candidates(prior)
    while len(found) < _MOST_CHANGES:
        ordered = _by_probability(difference, candidates)
        if difference.evidence(ordered[0]) < (0.0 if difference.probability < SIGNIFICANT else _CONVINCING):
            break
        plausible = [change for change in ordered if change is ordered[0] or change.probability >= _PLAUSIBLE]
        found.append([difference.estimated(change) for change in plausible])
        difference = difference.without(ordered[0])
    return found


def _by_probability(difference: Difference, candidates: Sequence[Change]) -> list[Change]:
    """Return the best size of each kind of each sensor, the most probable first."""
    best: dict[tuple[str, int], tuple[float, Change]] = {}
    for change in candidates:
        evidence = difference.evidence(change)
        key = change.kind, change.sensor
        if key not in best or evidence > best[key][0]:
            best[key] = evidence, change
    ordered = sorted(best.values(), key=lambda pair: -pair[0])
    weight = np.exp(np.array([evidence for evidence, _ in ordered]) - ordered[0][0])
    return [
        replace(change, probability=float(part))
        for (_, change), part in zip(ordered, weight / weight.sum(), strict=True)
    ]


def _candidates(prior: Prior) -> list[Change]:
    _, derivative = prior.in_convention(prior.errors)
    intensity_T = prior.calibration.intensity_T
    candidates = []
    for sensor in range(prior.errors.sensor_count):
        for place, kind in enumerate(KINDS):
            first = 12 * sensor + 3 * place
            directions = derivative[:, first : first + 3]
            if not directions.any():
                continue
            for size_T in _SIZES_T:
                size = size_T if kind == "bias" else size_T / intensity_T
                candidates.append(Change(kind, sensor, directions, np.full(3, size**2)))
    return candidates
