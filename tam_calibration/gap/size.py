"""The size of a gap, and the evidence for each effect that may cause it.

The size is the residual energy of held-out samples, compared with white noise.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import pairwise
from math import log
from operator import add

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect, Finding, FoundEffect, LinearEffect
from tam_calibration.effects.grades import MOST, NEARLY_ALL, SLIGHT
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.effects.states import Times
from tam_calibration.fit.moments import jackknife
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, best_form, refined
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import VISIBLE, Base, twice_log_likelihood_ratio
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Considered, Size
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import TENSOR_OUTPUTS
from tam_calibration.model.recording import Recording, channel_in_words
from tam_calibration.model.units import FloatArray


def words_of(channel: str) -> str:
    """Return a channel of a recording as sentences on what it shows name it."""
    return "scalar magnetometer" if channel == "scalar_T" else channel_in_words(channel)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The evidence for one hypothesis in a model's residual.

    Parameters
    ----------
    effect : str
        Name of the effect.
    form : Hypothesis or Finding
        Its form with the most evidence.
    delta_bic : float
        BIC of the model without it less that of the model with it: positive speaks for it.
    gain : float
        Twice the log-likelihood ratio.
    is_certain : bool
        See ``Finding``.
    """

    effect: str
    form: Hypothesis | Finding
    delta_bic: float
    gain: float
    is_certain: bool = False


def unusable(effect: Effect, recording: Recording, covariates: Covariates) -> Considered | None:
    """Return why a recording cannot show an effect, or None where it can.

    Parameters
    ----------
    effect : Effect
        Its channels must be recorded, and it must see no obstacle in the covariates.
    recording : Recording
        As given, with None for a channel that was not recorded.
    covariates : Covariates
        Of the recording at the nominal calibration.
    """
    for channel in effect.channels:
        if recording.channel(channel) is None:
            why = f"needs the {words_of(channel)} channel, which is not recorded"
            return Considered(effect.name, "channel_missing", why)
    obstacle = effect.obstacle(covariates)
    return None if obstacle is None else Considered(effect.name, "not_identifiable", obstacle)


def examine(base: Base, effect: Effect, sensors: frozenset[int] = EVERYWHERE, times: Times = ()) -> Evidence | str:
    """Return the evidence for an effect, or why there is none.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which evidence is sought.
    effect : Effect
        Fitted by regression, or found by a test of its own.
    sensors : frozenset of int
        Where it may act, indices, ``SCALAR`` or ``ALL``: empty for everywhere. A test of its own looks everywhere.
    times : tuple of tuple of float
        At which it may come and go, seconds: of each course that a law may have.
    """
    if isinstance(effect, LinearEffect):
        form = best_form(base, effect, sensors, times)
        if form is None:
            return "no part of it is visible beside the calibration in this recording"
        return evidence_of(base, form)
    assert isinstance(effect, FoundEffect)
    finding = effect.find(base.channels.residuals)
    if isinstance(finding, str):
        return finding
    delta_bic = finding.gain - finding.parameter_count * log(base.channels.count)
    return Evidence(effect.name, finding, delta_bic, finding.gain, finding.is_certain)


def evidence_of(base: Base, form: Hypothesis) -> Evidence:
    """Return the evidence for an effect in a form.

    Parameters
    ----------
    base : Base
        Null model at which the form was selected.
    form : Hypothesis
        Terms of the effect, with the energy that they explain and their ΔBIC.
    """
    gain = twice_log_likelihood_ratio(base.energy, form.selection.gain, base.channels.count)
    return Evidence(form.effect.name, form, form.selection.delta_bic, gain)


def sharpened(base: Base, weighed: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the shapes of the strongest effects refined, and of special cases of the strongest.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the shapes are refined.
    weighed : sequence of Evidence
        For the effects, at this base; those with nearly the largest ΔBIC are refined.
    """
    known = [one for one in weighed if isinstance(one.form, Hypothesis) and one.delta_bic > 0]
    most, strongest = max(((one.delta_bic, one.effect) for one in known), default=(0.0, ""))
    return tuple(
        evidence_of(base, refined(base, one.form))
        if isinstance(one.form, Hypothesis)
        and one in known
        and (one.delta_bic > NEARLY_ALL * most or one.form.effect.is_within(strongest))
        else one
        for one in weighed
    )


FOLDS = 5
"""Folds of the cross-validation: four fifths of a recording determine nearly as much as all of it."""


def folds_of(sample_count: int, interleaved: bool) -> list[list[slice]]:
    """Return the samples of each fold: blocks of time, or every fifth sample for free functions of time.

    Parameters
    ----------
    sample_count : int
        Number of samples of the recording, or of those that the fit takes.
    interleaved : bool
        Whether to take every fifth sample.

    Returns
    -------
    list of list of slice
        Of each of the five folds the slices that it consists of.
    """
    if interleaved:
        return [[slice(fold, sample_count, FOLDS)] for fold in range(FOLDS)]
    # Twelve blocks a fold, so that no fold holds all samples of an attitude.
    bounds = np.linspace(0, sample_count, FOLDS * 12 + 1).astype(int).tolist()
    blocks = [slice(low, high) for low, high in pairwise(bounds)]
    return [blocks[fold::FOLDS] for fold in range(FOLDS)]


def held_out_energy(channels: WhitenedChannels, designs: Sequence[Regressors], interleaved: bool) -> FloatArray:
    """Return the energy (F,) of each fold under the fit of designs to the other folds.

    Parameters
    ----------
    channels : WhitenedChannels
        Whitened channels.
    designs : sequence of Regressors
        Of the calibration, then of effects.
    interleaved : bool
        See ``folds_of``.
    """
    joined = Regressors.joined(designs)
    folds = folds_of(len(channels.intensity_residual_T), interleaved)
    parts = [reduce(add, (channels.normal(joined, block) for block in fold)) for fold in folds]
    whole = reduce(add, parts)
    energy = []
    for test in parts:
        train = whole - test
        white = whitening(train.information, VISIBLE)
        step = white @ (white.T @ train.score)
        energy.append(test.energy - 2 * step @ test.score + step @ test.information @ step)
    return np.array(energy)


def held_out(model: Model, interleaved: bool, variance: float) -> FloatArray:
    """Return χ²/n - 1 (F,) of the residual of a model in each held-out fold.

    The variance of the calibration itself counts as noise.

    Parameters
    ----------
    model : Model
        Fitted to all samples that count.
    interleaved : bool
        See ``folds_of``.
    variance : float
        Of the noise, over that stated.
    """
    base = model.base()
    energy = held_out_energy(base.channels, base.designs, interleaved)
    size = base.channels.count + base.calibration_rank * FOLDS / (FOLDS - 1)
    return energy / (size / FOLDS * variance) - 1


def is_interleaved(model: Model) -> bool:
    """Whether an accepted effect is a free function of time."""
    return any(part.effect.is_free_in_time for part in model.parts)


def noise_variance(model: Model, laws: Sequence[Law]) -> float:
    """Return the variance of the white noise of the channels, in units of the variance that the model's array has.

    The residual variance less the laws of the residual, at most ``LARGEST_NOISE``² and at least most of the floor from
    differences of neighbouring samples, which no law may explain away; where they do not determine it, most of the
    noise stated is such a floor.

    Parameters
    ----------
    model : Model
        With the causes.
    laws : sequence of Law
        Of what this model leaves.
    """
    base = model.base()
    floor = floor_of(base.channels, model.array)
    ratios = floor.level_T[:-1] / floor.stated_T[:-1]
    white = float(np.median(ratios)) ** 2 if floor.is_determined else MOST**2
    residual = base.energy / max(base.channels.count - base.rank, 1.0)
    variance = min(residual * max(1 - sum(law.part for law in laws), 0.0), LARGEST_NOISE**2)
    # The variance from differences is uncertain by some per cent.
    return float(max(variance, min(0.8 * white, residual, LARGEST_NOISE**2)))


def measure(nominal: Model, model: Model, variance: float) -> Size:
    """Return the size of the gap before the causes of a model, and with them.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    interleaved = is_interleaved(model)
    first, last = (held_out(one, interleaved, variance) for one in (nominal, model))
    before, after = float(np.sqrt(max(first.mean(), 0))), float(np.sqrt(max(last.mean(), 0)))
    closed, interval = _closed(first, last)
    floor = float(np.sqrt(variance * np.mean(model.row_noise_T**2)))
    tensors = [_tensor_excess(one, variance) for one in (nominal, model)]
    return Size(before, after, before * floor, after * floor, tensors[0], tensors[1], floor, closed, interval)


def _closed(first: FloatArray, last: FloatArray) -> tuple[float, tuple[float, float]]:
    from scipy.special import ndtri

    def part(kept: np.ndarray | slice) -> float:
        total = first[kept].mean()
        return float(np.clip(1 - max(last[kept].mean(), 0) / total, 0, 1)) if total > 0 else 0.0

    value = part(slice(None))
    left_out = np.array([part(np.arange(len(first)) != fold) for fold in range(len(first))])
    half = float(ndtri(1 - SLIGHT / 2) * np.sqrt(jackknife(left_out)[0, 0]))
    return value, (max(value - half, 0.0), min(value + half, 1.0))


def _tensor_excess(model: Model, variance: float) -> float:
    """Return the root of the summed squares of the tensor's components beyond noise, T/m."""
    if not model.array.has_gradient:
        return float("nan")
    correction = model.array.operator[list(TENSOR_OUTPUTS)] @ model.errors.joint_inverse
    unbiased = (model.recording.readings_T - model.errors.bias_T).reshape(model.recording.sample_count, -1)
    tensor = (unbiased - model.signal()[:, :-1])[model.is_counted] @ correction.T
    noise = variance * correction**2 @ np.repeat(model.array.vector_noise_T**2, 3)
    return float(np.sqrt(max(np.sum(np.mean(tensor**2, axis=0)) - noise.sum(), 0.0)))
