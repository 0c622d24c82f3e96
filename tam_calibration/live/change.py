"""Whether the sensors have changed since a moment, which of them and what: a generalised likelihood ratio.

Before that moment the errors were x ~ N(x₀, P). Samples since then have at x₀ the information I and the gradient
g ~ N(I (x - x₀ + B δ), I), where B δ is a change of the errors along the columns of B. With the unknown x integrated
out, W = (1 + I P)⁻¹ I is the information that the samples give of changes, and s = (1 + I P)⁻¹ g its score: without a
change Λ = sᵀ B (Bᵀ W B)⁻¹ Bᵀ s is a χ² of as many degrees of freedom as B has columns, and the most probable change
is (Bᵀ W B)⁻¹ Bᵀ s (Willsky and Jones 1976).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from tam_calibration.core.least_squares import scaled
from tam_calibration.correction.acceptance import are_possible
from tam_calibration.fit.contradiction import Hypothesis, changes_of_sensors
from tam_calibration.fit.likelihood import Linearization
from tam_calibration.model.array import UNIT_TENSORS, Array
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray, to_degrees, to_nanotesla

CLEAR_RATIO = 2 * float(np.log(100.0))
"""By how much a ratio exceeds another that is ruled out: the data are then a hundred times less probable by that."""

GRADIENT = "gradient of the field"


def hypotheses(errors: SensorErrors, array: Array) -> tuple[Hypothesis, ...]:
    """Return what may have changed: errors of an array's sensors, or that it is near a source.

    Parameters
    ----------
    errors : SensorErrors
        Of the K sensors.
    array : Array
        Where they are.
    """
    changes, count = changes_of_sensors(errors), errors.sensor_count
    if not array.has_gradient:
        return changes
    biases = np.eye(12 * count).reshape(12 * count, count, 12)[:, :, 6:9].reshape(12 * count, -1)
    fields = np.einsum("kij,cjl,kl->kic", errors.matrix, UNIT_TENSORS, array.positions_m).reshape(3 * count, 5)
    return (*changes, Hypothesis(f"{GRADIENT}, as near a source", GRADIENT, 0, biases @ fields, (), "T/m"))


@dataclass(frozen=True, eq=False)
class Evidence:
    """What samples say of a hypothesis.

    Parameters
    ----------
    hypothesis : Hypothesis
        What may have changed.
    size : (M,) array
        Most probable change of its unknowns.
    covariance : (M, M) array
        Of these; infinite on the diagonal for what is not seen.
    ratio : float
        Twice the logarithm of the likelihood ratio against no change.
    score : float
        The ratio less what its unknowns gain by chance (Schwarz 1978).
    """

    hypothesis: Hypothesis
    size: FloatArray
    covariance: FloatArray
    ratio: float
    score: float

    @property
    def change(self) -> FloatArray:
        """(12 K,) most probable change of the errors, SI."""
        return self.hypothesis.directions @ self.size

    @property
    def reach(self) -> FloatArray:
        """(M,) sizes that the change may have; of unknowns that are not seen that of the largest that is."""
        variance = np.diag(self.covariance)
        reach = np.sqrt(self.size**2 + np.where(np.isfinite(variance), variance, 0.0))
        reach[~np.isfinite(variance)] = reach.max()
        return reach

    @property
    def sentence(self) -> str:
        """What has changed and by how much, for people."""
        errors = np.sqrt(np.diag(self.covariance))
        # Standard errors from which a component of a change is named.
        components = [
            f"{name} {_in_unit(value, self.hypothesis.unit)} ± {_in_unit(error, self.hypothesis.unit, '')}".strip()
            for name, value, error in zip(self.hypothesis.components, self.size, errors, strict=False)
            if abs(value) > 3.0 * error
        ]
        unit = {"T": " nT", "rad": "°", "1": " ppm"}.get(self.hypothesis.unit, "")
        return self.hypothesis.name + (f" by {', '.join(components)}{unit}" if components else "")


def _in_unit(value: float, unit: str, form: str = "+") -> str:
    factor = {"T": to_nanotesla(1.0), "rad": to_degrees(1.0)}.get(unit, 1e6)
    return f"{factor * float(value):{form}.3g}"


class Before(NamedTuple):
    """What was known before the samples in which a change is looked for.

    Parameters
    ----------
    covariance : (12 K, 12 K) array
        Of the errors, SI.
    samples : int
        Their number.
    excess : float
        Variance of the residuals over that which the noise is stated to have.
    """

    covariance: FloatArray
    samples: int
    excess: float


class Weighing:
    """Weighs hypotheses against each other by samples.

    Parameters
    ----------
    among : sequence of Hypothesis
        The hypotheses.
    chance : float
        Of a ratio of one of them, without a change, from which it is believed.
    """

    def __init__(self, among: Sequence[Hypothesis], chance: float) -> None:
        self._among, self._chance = among, chance

    def weigh(self, information: FloatArray, gradient: FloatArray, before: Before) -> tuple[Evidence, ...]:
        """Return the most probable hypothesis and those that are not clearly less so, or none where it may be chance.

        Parameters
        ----------
        information, gradient : (12 K, 12 K) and (12 K,) arrays
            Of the samples, at the errors before them, by the errors, SI.
        before : Before
            The samples.
        """
        from scipy.special import chdtri

        marginal = _marginal(information, gradient, before.covariance)
        found = _not_ruled_out([_evidence(each, *marginal, before) for each in self._among])
        return found if found[0].ratio > chdtri(len(found[0].size), self._chance) else ()

    def weigh_far(
        self, linearize: Callable[[SensorErrors], Linearization], errors: SensorErrors, before: Before
    ) -> tuple[Evidence, ...]:
        """Return the same of a change so large that lengths are no straight lines over it: each is fitted by itself.

        Parameters
        ----------
        linearize : callable
            From errors to what the samples say there.
        errors : SensorErrors
            Before the samples.
        before : Before
            The samples.
        """
        fitted = (_fitted(hypothesis, linearize, errors, before) for hypothesis in self._among)
        return _not_ruled_out([evidence for evidence in fitted if evidence is not None])


def _not_ruled_out(found: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Return the most probable hypothesis and after it those that are not clearly less so."""
    ordered = sorted(found, key=lambda evidence: -evidence.score)
    return tuple(evidence for evidence in ordered if ordered[0].score - evidence.score <= CLEAR_RATIO)


def _fitted(
    hypothesis: Hypothesis, linearize: Callable[[SensorErrors], Linearization], errors: SensorErrors, before: Before
) -> Evidence | None:
    """Return what samples say of a hypothesis that is fitted to them; None where no sensors are like that."""
    start = errors.to_vector().ravel()
    change = np.zeros_like(start)
    without = here = linearize(errors)
    # 20 and 1e-6: steps to a change, and the part that the last may leave: six lead to the right one, wrong ones may
    # not settle.
    for _ in range(20):
        both = here.both
        marginal = _marginal(both.information, both.score + both.information @ change, before.covariance)
        evidence = _evidence(hypothesis, *marginal, before)
        left, change = evidence.change - change, evidence.change
        vector = (start + change).reshape(-1, 12)
        if not are_possible(vector):
            return None
        here = linearize(SensorErrors.from_vector(vector, errors.orientation))
        if np.abs(left).max() <= 1e-6 * np.abs(change).max():
            break
    ratio = (without.both.energy - here.both.energy) / before.excess
    return replace(evidence, ratio=ratio, score=evidence.score + ratio - evidence.ratio)


def _evidence(hypothesis: Hypothesis, of_changes: FloatArray, score: FloatArray, before: Before) -> Evidence:
    """Return what samples say of a hypothesis, by what ``_marginal`` returns of them."""
    directions = hypothesis.directions
    unit, scale = scaled(directions.T @ of_changes @ directions)
    values, vectors = np.linalg.eigh(unit)
    # Information along a direction, over that of its unknowns known alone, below which it is not seen: above rounding.
    unseen = 1e-9
    seen = values > unseen
    along = vectors[:, seen] / scale[:, None]
    size = along / values[seen] @ (along.T @ (directions.T @ score))
    covariance = before.excess * along / values[seen] @ along.T
    is_open = np.abs(vectors[:, ~seen]).max(axis=1, initial=0.0) > np.sqrt(unseen)
    covariance[is_open, is_open] = np.inf
    ratio = float(size @ (directions.T @ score)) / before.excess
    return Evidence(hypothesis, size, covariance, ratio, ratio - len(size) * float(np.log(max(before.samples, 2))))


def _marginal(information: FloatArray, gradient: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return information (12 K, 12 K) and score (12 K,) of changes, the errors before them integrated out."""
    unit, scale = scaled(information)
    before = covariance * np.outer(scale, scale)
    right = np.column_stack([unit, gradient / scale])
    solved = np.linalg.solve(np.eye(len(scale)) + unit @ before, right)
    return (solved[:, :-1] + solved[:, :-1].T) / 2 * np.outer(scale, scale), solved[:, -1] * scale
