"""Standard errors of coefficients that are robust to autocorrelated and heteroscedastic residuals.

The error of a coefficient is the sum over the samples of its influence times their residuals. Its variance is estimated
from the same products weighted by slow cosines of time: where the products are stationary, these weighted sums have the
variance of the error itself (``core.slow_cosines``). The mean square of a few of them is the estimate; it has few
degrees of freedom, but holds for any correlation time up to a fraction of the recording. The fit itself removes a part
of each sum; how much, and how many degrees of freedom remain, follows from the design for a white residual (Bell and
McCaffrey, Bias reduction in standard errors, Surv. Methodol. 28, 2002, p. 169).
"""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np

from tam_calibration.core.slow_cosines import BLOCKS, COSINES, slow_cosines
from tam_calibration.effects.term import Term
from tam_calibration.gap.checks import CHANCE
from tam_calibration.gap.regression import VISIBLE, Base
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.units import FloatArray


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
    solve, own = _solution(base, information.sum(axis=0), visible)
    residual = score - information @ (solve @ score.sum(axis=0))
    influence = solve[:, own]
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


def _solution(base: Base, information: FloatArray, visible: FloatArray) -> tuple[FloatArray, slice]:
    """Return the inverse of the joint information within the visible directions, and the columns of the effects."""
    width = len(information) - len(visible)
    carried = np.vstack([-base.inverse @ information[:width, width:], np.eye(len(visible))])
    solve = carried @ visible @ carried.T
    solve[:width, :width] += base.inverse
    return solve, slice(width, None)


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
    quantile = float(stdtrit(freedom, 1 - CHANCE / 2) / ndtri(1 - CHANCE / 2))
    return quantile * float(np.sqrt(energy.sum() * COSINES / total))
