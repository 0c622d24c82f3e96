"""The size of a gap, and the evidence for each effect that may cause it.

The size is the residual energy of held-out samples, compared with white noise.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from functools import wraps
from itertools import pairwise
from math import expm1, log
from typing import Any, TypeVar
from weakref import WeakKeyDictionary

import numpy as np

from tam_calibration.core.normal_equations import Normal
from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Effect, Finding, FoundEffect, LinearEffect
from tam_calibration.effects.grades import NEARLY_ALL
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.effects.states import Times
from tam_calibration.gap.checks import CHANCE
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, best_form, refined
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import VISIBLE, Base, pseudo_inverse, twice_log_likelihood_ratio
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Considered, Size
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.array import TENSOR_OUTPUTS
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray

Value = TypeVar("Value")


def cached_by_base(function: Callable[..., Value]) -> Callable[..., Value]:
    """Cache the values of a function of a base and further arguments as long as the base exists."""
    known: WeakKeyDictionary[Base, dict[tuple[Any, ...], Value]] = WeakKeyDictionary()

    @wraps(function)
    def cached(base: Base, *arguments: Any) -> Value:
        of_base = known.setdefault(base, {})
        if arguments not in of_base:
            of_base[arguments] = function(base, *arguments)
        return of_base[arguments]

    return cached


CHANNEL_NAMES = {
    "scalar_T": "scalar magnetometer",
    "temperature_C": "temperature",
    "current_A": "current",
    "attitude": "attitude",
}
"""The channels of a recording in words."""


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
        if getattr(recording, channel, None) is None:
            name = CHANNEL_NAMES[channel]
            return Considered(effect.name, "channel_missing", f"needs the {name} channel, which is not recorded")
    obstacle = effect.obstacle(covariates)
    return None if obstacle is None else Considered(effect.name, "not_identifiable", obstacle)


def usable(
    effects: Mapping[str, Effect], without: Collection[str], channels: WhitenedChannels
) -> tuple[dict[str, Effect], list[Considered]]:
    """Return the effects that this recording can show, and why it cannot show the others.

    Parameters
    ----------
    effects : mapping of str to Effect
        By name.
    without : collection of str
        Names of effects that are passed over.
    channels : WhitenedChannels
        Of the recording at the nominal calibration.
    """
    reasons = {
        name: unusable(effect, channels.recording, channels.covariates)
        for name, effect in effects.items()
        if name not in without
    }
    tried = {name: effects[name] for name, reason in reasons.items() if reason is None}
    return tried, [reason for reason in reasons.values() if reason is not None]


@cached_by_base
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


def energy_explained(one: Evidence, base: Base) -> float:
    """Return the energy that an effect explains of the residual of a base.

    Parameters
    ----------
    one : Evidence
        For the effect, in the residual of this base.
    base : Base
        Null model with its residual energy.
    """
    return base.energy * -expm1(-one.gain / base.channels.count)


def sharpened(base: Base, weighed: Sequence[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the shapes of the strongest effects refined, and of special cases of the strongest.

    Parameters
    ----------
    base : Base
        Null model, in the residual of which the shapes are refined.
    weighed : sequence of Evidence
        For the effects, at this base; those with nearly the largest ΔBIC are refined.
    """
    linear = [one for one in weighed if isinstance(one.form, Hypothesis)]
    strongest = max(linear, key=lambda one: one.delta_bic, default=None)
    if strongest is None or strongest.delta_bic <= 0:
        return tuple(weighed)
    return tuple(_refined(base, one) if _is_near(one, strongest) else one for one in weighed)


def _is_near(one: Evidence, strongest: Evidence) -> bool:
    """Whether a hypothesis has nearly the evidence of the strongest, or is a special case of it that has any."""
    if not isinstance(one.form, Hypothesis) or one.delta_bic <= 0:
        return False
    return one.delta_bic > NEARLY_ALL * strongest.delta_bic or one.form.effect.is_within(strongest.effect)


@cached_by_base
def _refined(base: Base, one: Evidence) -> Evidence:
    assert isinstance(one.form, Hypothesis)
    return evidence_of(base, refined(base, one.form))


FOLDS = 5
"""Folds of the cross-validation: four fifths of a recording determine nearly as much as all of it."""

_BLOCKS_PER_FOLD = 12
"""Blocks of time in a fold, so that no fold holds all samples of an attitude."""


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
    bounds = np.linspace(0, sample_count, FOLDS * _BLOCKS_PER_FOLD + 1).astype(int).tolist()
    blocks = [slice(low, high) for low, high in pairwise(bounds)]
    return [blocks[fold::FOLDS] for fold in range(FOLDS)]


def held_out_energy(
    channels: WhitenedChannels, designs: Sequence[Regressors], widths: Sequence[int], interleaved: bool
) -> FloatArray:
    """Return the energy (F, M) of each fold under fits of M nested models to the other folds.

    Parameters
    ----------
    channels : WhitenedChannels
        Whitened channels.
    designs : sequence of Regressors
        Of the calibration, then of effects.
    widths : sequence of int
        How many of the designs each of M models has.
    interleaved : bool
        See ``folds_of``.
    """
    joined = Regressors.joined(designs)
    ends = np.cumsum([design.width for design in designs])
    parts = []
    for fold in folds_of(len(channels.intensity_residual_T), interleaved):
        blocks = [channels.normal(joined, block) for block in fold]
        parts.append(sum(blocks[1:], start=blocks[0]))
    whole = sum(parts[1:], start=parts[0])
    energy = np.empty((len(parts), len(widths)))
    for row, part in enumerate(parts):
        train = whole - part
        for column, width in enumerate(widths):
            energy[row, column] = _energy(train, part, int(ends[width - 1]))
    return energy


def _energy(train: Normal, test: Normal, width: int) -> float:
    """Return the energy of the test samples under the fit of the first columns to the training samples."""
    first = slice(0, width)
    step = pseudo_inverse(train.information[first, first], VISIBLE) @ train.score[first]
    return float(test.energy - 2 * step @ test.score[first] + step @ test.information[first, first] @ step)


LEAST_NOISE = 0.5
"""Least white noise, as a part of that stated, where differences do not determine it."""

_CERTAIN_PART = 0.8
"""Part of the variance from differences that is certainly noise: the estimate is uncertain by some per cent."""


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
    energy = held_out_energy(base.channels, base.designs, [len(base.designs)], interleaved)[:, 0]
    size = base.channels.count + base.calibration_rank * FOLDS / (FOLDS - 1)
    share = size / base.channels.count
    return energy / (base.channels.count / FOLDS * share * variance) - 1


def is_interleaved(model: Model) -> bool:
    """Whether an accepted effect is a free function of time."""
    return any(part.effect.is_free_in_time for part in model.parts)


def noise_variance(model: Model, laws: Sequence[Law]) -> float:
    """Return the variance of the white noise of the channels, in units of the variance that the model's array has.

    The residual variance less the laws of the residual, at most ``LARGEST_NOISE``² and at least most of the floor from
    differences of neighbouring samples, which no law may explain away.

    Parameters
    ----------
    model : Model
        With the causes.
    laws : sequence of Law
        Of what this model leaves.
    """
    base = model.base()
    residual = base.energy / max(base.channels.count - base.rank, 1.0)
    variance = min(residual * max(1 - sum(law.part for law in laws), 0.0), LARGEST_NOISE**2)
    return float(max(variance, min(_CERTAIN_PART * _white_part(model), residual, LARGEST_NOISE**2)))


def _white_part(model: Model) -> float:
    """Return the variance of white noise from differences, the median of the rows, over that of the model's array."""
    floor = floor_of(model.channels(model.signal() if model.parts else None), model.array)
    if not floor.is_determined:
        return LEAST_NOISE**2
    return float(np.median(floor.level_T[:-1] / floor.stated_T[:-1])) ** 2


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
    from scipy.special import stdtrit

    def part(kept: np.ndarray) -> float:
        total = first[kept].mean()
        return float(np.clip(1 - max(last[kept].mean(), 0) / total, 0, 1)) if total > 0 else 0.0

    everything = np.ones(len(first), dtype=bool)
    value = part(everything)
    left_out = np.array([part(np.arange(len(first)) != fold) for fold in range(len(first))])
    error = np.sqrt((len(first) - 1) / len(first) * np.sum((left_out - left_out.mean()) ** 2))
    # Student's t has as many degrees of freedom as there are folds less one.
    half = float(stdtrit(len(first) - 1, 1 - CHANCE / 2) * error)
    return value, (max(value - half, 0.0), min(value + half, 1.0))


def _tensor_excess(model: Model, variance: float) -> float:
    """Return the root of the summed squares of the tensor's components beyond noise, T/m."""
    if not model.array.has_gradient:
        return float("nan")
    counted = model.is_counted
    readings = model.recording.readings_T
    if model.parts:
        readings = readings - model.signal()[:, :-1].reshape(readings.shape)
    restored = model.errors.restore(readings[counted]).reshape(int(counted.sum()), -1)
    tensor = restored @ model.array.operator[list(TENSOR_OUTPUTS)].T
    unmixed = np.einsum(
        "rki,kij->rkj", model.array.operator[list(TENSOR_OUTPUTS)].reshape(5, -1, 3), np.linalg.inv(model.errors.matrix)
    ).reshape(5, -1)
    noise = variance * unmixed**2 @ np.repeat(model.array.vector_noise_T**2, 3)
    return float(np.sqrt(max(np.sum(np.mean(tensor**2, axis=0)) - noise.sum(), 0.0)))
