"""The parameters of a calibration and its effects at the end of their common fit, with the uncertainty of both.

The standard errors are robust to autocorrelated and heteroscedastic residuals. The error of a coefficient is the sum
over the samples of its influence times their residuals. Its variance is estimated from the same products weighted by
slow cosines of time: where the products are stationary, these weighted sums have the variance of the error itself
(``core.noise``). The mean square of a few of them is the estimate; it has few degrees of freedom, but holds for
any correlation time up to a fraction of the recording. The fit itself removes a part of each sum; how much, and how
many degrees of freedom remain, follows from the design for a white residual (Bell and McCaffrey, Bias reduction in
standard errors, Surv. Methodol. 28, 2002, p. 169).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np

from tam_calibration.core.noise import BLOCKS, COSINES, slow_cosines
from tam_calibration.correction.parts import EffectSize
from tam_calibration.effects.grades import SLIGHT
from tam_calibration.effects.removal import on_sensors
from tam_calibration.effects.term import Coefficient, Term
from tam_calibration.fit.ellipsoid import free_scale
from tam_calibration.gap.hypothesis import Part
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import VISIBLE, Base
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, FittedEffect, Shape
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

_STEP = 0.01
"""Step of a parameter of the shape for numerical derivatives, as a part of its value."""


def covariance_of(base: Base, effects: Sequence[Regressors], left_out: Sequence[Term]) -> FloatArray:
    """Return the covariance (P, P) of the coefficients of effects: of ``sandwich``, and of what was left out unseen.

    Parameters
    ----------
    base : Base
        As of ``sandwich``.
    effects : sequence of Regressors
        P columns in all.
    left_out : sequence of Term
        Of the same effects, at other places; may be empty.
    """
    covariance = sandwich(base, effects)
    return covariance + unseen(base, effects, base.channels.design(left_out)) if left_out else covariance


def sandwich(base: Base, effects: Sequence[Regressors]) -> FloatArray:
    """Return the covariance of the coefficients of effects, fitted together with the calibration.

    Parameters
    ----------
    base : Base
        Of the calibration and other nuisance parameters, at channels from which the signal of the effects is removed.
    effects : sequence of Regressors
        P columns in all.

    Returns
    -------
    (P, P) array
        Scaled so that ± 1.96 standard errors cover 95 % despite the few degrees of freedom. Directions that the
        recording does not determine have zero variance.
    """
    joined = Regressors.joined([*base.designs, *effects])
    information, score = _by_block(base.channels, joined)
    visible = base.project(Regressors.joined(effects)).inverse()[0]
    # The inverse of the joint information within the directions of the effects that are visible.
    width = joined.width - len(visible)
    carried = np.vstack([-base.inverse @ information.sum(axis=0)[:width, width:], np.eye(len(visible))])
    solve = carried @ visible @ carried.T
    solve[:width, :width] += base.inverse
    residual, influence = score - information @ (solve @ score.sum(axis=0)), solve[:, width:]
    cosines = slow_cosines()
    sums = cosines.T @ (residual @ influence)
    scale = np.array([_scale(information, solve, one, cosines) for one in influence.T])
    return np.asarray(scale[:, None] * (sums.T @ sums / COSINES) * scale)


def unseen(base: Base, effects: Sequence[Regressors], left_out: Regressors) -> FloatArray:
    """Return the covariance (P, P) of the coefficients of effects due to terms that were omitted as insignificant.

    The common field carries what is omitted at one sensor over to the coefficients of the others. Each omitted
    coefficient is taken as uniformly distributed within the limits at which BIC would have selected it.

    Parameters
    ----------
    base : Base
        As of ``sandwich``.
    effects : sequence of Regressors
        P columns in all.
    left_out : Regressors
    """
    both = base.project(Regressors.joined([*effects, left_out]))
    width = sum(design.width for design in effects)
    fitted, others = slice(width), slice(width, None)
    carried = both.take(np.arange(width)).inverse()[0] @ both.information[fitted, others]
    alone = np.diag(both.information[others, others] - both.information[others, fitted] @ carried)
    count, is_visible = base.channels.count, alone > VISIBLE * both.before[others]
    limit = np.divide(np.log(count) * base.energy / count, alone, out=np.zeros_like(alone), where=is_visible)
    return np.asarray(carried * (limit / 3) @ carried.T)


def _by_block(channels: WhitenedChannels, design: Regressors) -> tuple[FloatArray, FloatArray]:
    """Return the information (M, Q, Q) and the score (M, Q) of a design in blocks of time."""
    bounds = np.linspace(0, len(design.features), BLOCKS + 1).astype(int).tolist()
    parts = [slice(start, stop) for start, stop in pairwise(bounds)]
    information = np.array([channels.cross(design, design, part) for part in parts])
    return information, np.array([channels.score(design, part) for part in parts])


def _scale(information: FloatArray, solve: FloatArray, influence: FloatArray, cosines: FloatArray) -> float:
    """Return the factor by which the root mean square of a coefficient's sums is too small for white residuals.

    The sums' covariance is wᵀ P w, with w the influence times the cosines and P what the fit leaves.
    """
    from scipy.special import ndtri, stdtrit

    answer = information @ influence
    energy = answer @ influence
    sums = cosines.T @ answer
    covariance = (cosines.T * energy) @ cosines - sums @ solve @ sums.T
    total = float(np.trace(covariance))
    if total <= 0:
        return 0.0
    freedom = total**2 / float(np.sum(covariance**2))
    quantile = float(stdtrit(freedom, 1 - SLIGHT / 2) / ndtri(1 - SLIGHT / 2))
    return quantile * float(np.sqrt(energy.sum() * COSINES / total))


NO_SIZE = EffectSize(np.zeros(9), np.zeros(9))
"""Of an effect that adds nothing to the outputs."""


@dataclass(frozen=True, eq=False)
class Joint:
    """The parameters of calibration and effects at the end of their fit.

    Parameters
    ----------
    model : Model
        With the array, the errors and the intensity of the calibration.
    free : tuple of tuple of str
        Parameters of the shape of each effect that were fitted.
    """

    model: Model
    free: tuple[tuple[str, ...], ...]

    @classmethod
    def of(cls, model: Model) -> "Joint":
        """Return the parameters of a model whose effects have no free parameters of their shapes."""
        return cls(model, ((),) * len(model.parts))

    @cached_property
    def effects(self) -> tuple[FittedEffect, ...]:
        """The effects with values and standard errors."""
        effects = []
        for (part, terms, covariance), names in zip(self._fits, self.free, strict=True):
            count = len(part.values)
            variance = np.diag(covariance)[count:]
            known = {name: float(np.sqrt(value)) for name, value in zip(names, variance, strict=True) if value > 0}
            fitted = part.fitted(terms[: len(part.keys)], covariance[:count, :count])
            effects.append(replace(fitted, shape_errors=known))
        return tuple(effects)

    @cached_property
    def shared_covariance(self) -> FloatArray:
        """What the effects' uncertainty adds to the covariance (12 K, 12 K) of errors in the first sensor's frame."""
        if not self.model.parts:
            return np.zeros((self.model.errors.to_vector().size,) * 2)
        shift = self._nominal.inverse @ self._channels.cross(self._nominal.designs[0], self._design)
        return self._of_errors(-shift, self._covariance)

    @cached_property
    def covariance_in_world(self) -> FloatArray:
        """The covariance (12 K, 12 K) of the errors in the field of the world, the effects taken as known.

        It is scaled by the residual, as the noise of an attitude is not stated.
        """
        base, own = self.model.base(), self._nominal.inverse
        return self._of_errors(np.eye(len(own)), base.energy / max(base.channels.count - base.rank, 1.0) * own)

    def _of_errors(self, shift: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return the covariance of the errors from that of P coefficients, whose units shift the design of them."""
        deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
        slope = np.column_stack([(self._moved(step) - self._moved(-step)) / 2 for step in (shift * deviation).T])
        slope[9:12] = 0  # the misalignment of the first sensor is zero
        correlation = covariance / np.outer(*[np.where(deviation > 0, deviation, 1)] * 2)
        return slope @ correlation @ slope.T

    def _moved(self, step: FloatArray) -> FloatArray:
        """Return the flattened parameters of the errors after a step of their design.

        Without a scalar the geometric mean of the determinants is kept at 1: nothing determines the common scale.
        """
        moved = self.model.moved(step, self._channels).errors
        if self.model.world is None and self.model.recording.scalar_T is None:
            matrix = free_scale(moved.matrix) * moved.matrix
            moved = SensorErrors.from_matrix(matrix, moved.bias_T, self.model.errors.orientation)
        return moved.to_vector().ravel()

    def sizes(self, unmix: FloatArray) -> tuple[EffectSize, ...]:
        """Return the size of each effect in outputs that are ``unmix`` (9, 3K) times the readings."""
        # The uncertainty of an effect's signal is averaged over 2000 samples, spread over the recording.
        some = slice(None, None, -(-self.model.recording.sample_count // 2000))
        sizes = []
        for (part, terms, covariance), fitted in zip(self._fits, self.effects, strict=True):
            if on_sensors(fitted) is None:
                sizes.append(NO_SIZE)
                continue
            added = part.signal(terms[: len(part.keys)], unmix.shape[1] + 1)[:, :-1] @ unmix.T
            fewer = [replace(term, features=term.features[some]) for term in terms]
            sizes.append(EffectSize(np.sqrt(np.mean(added**2, axis=0)), _deviation(fewer, unmix, covariance)))
        return tuple(sizes)

    @cached_property
    def _channels(self) -> WhitenedChannels:
        return self.model.base().channels

    @cached_property
    def _nominal(self) -> Base:
        return Base(self._channels, [self._channels.calibration])

    @cached_property
    def _terms(self) -> list[list[Term]]:
        """For each effect its terms, then one term for each free parameter of its shape."""
        return [
            [*part.terms(self._channels), *(_slope(part, name, self._channels) for name in names)]
            for part, names in zip(self.model.parts, self.free, strict=True)
        ]

    @cached_property
    def _design(self) -> Regressors:
        return self._channels.design([term for terms in self._terms for term in terms])

    @cached_property
    def _covariance(self) -> FloatArray:
        """Covariance of all coefficients and free shape parameters, the calibration marginalised."""
        left_out = [term for part in self.model.parts for term in part.left_out(self._channels)]
        return covariance_of(self._nominal, [self._design], left_out)

    @cached_property
    def _fits(self) -> list[tuple[Part, list[Term], FloatArray]]:
        """Each effect with its terms and the covariance of its parameters."""
        ends = np.cumsum([0, *(sum(len(term.coefficients) for term in terms) for terms in self._terms)]).tolist()
        blocks = [self._covariance[start:end, start:end] for start, end in pairwise(ends)]
        return list(zip(self.model.parts, self._terms, blocks, strict=True))


def _slope(part: Part, name: str, channels: WhitenedChannels) -> Term:
    """Return the derivative of what an effect adds by one parameter of its shape, as a term."""
    size = _STEP * part.shape[name] or _STEP
    count = channels.covariates.scalar_row + 1

    def added(value: float) -> FloatArray:
        shape: Shape = {**part.shape, name: value}
        moved = replace(part, shape=shape)
        return moved.signal(moved.terms(channels), count)

    above, below = added(part.shape[name] + size), added(part.shape[name] - size)
    change = above - below
    # At two equal layers the share of either makes no difference, but for rounding.
    # Rounding is 1e-15 of what an effect adds, and a step that says anything of a parameter changes more than 1e-6.
    slope = change / (2 * size) if np.abs(change).max() > 1e-9 * np.abs(above).max() else np.zeros_like(change)
    rows = np.flatnonzero(slope.any(axis=0))
    parameter = Coefficient(name, part.effect.shape_units[name])
    return Term(ALL, None, name, (parameter,), slope[:, rows], rows, np.zeros(len(rows), dtype=np.intp))


def _deviation(terms: Sequence[Term], unmix: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the root mean square (9,) of the standard deviation of what terms add to the outputs."""
    by_unit = [
        term.signal(unit, unmix.shape[1] + 1)[:, :-1] @ unmix.T
        for term in terms
        for unit in np.eye(len(term.coefficients))
    ]
    by_column = np.stack(by_unit, axis=-1)
    variance = np.einsum("nop,pq,noq->o", by_column, covariance, by_column, optimize=True) / len(by_column)
    return np.asarray(np.sqrt(variance))
