"""From a search to the verdict."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tam_calibration.effects.effect import ALL, Finding, FittedEffect
from tam_calibration.effects.excess_variance import Excess, Moments, best_excess
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.channels import Channels
from tam_calibration.gap.design import Design
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.looking import CLEAN, Step
from tam_calibration.gap.model import Model
from tam_calibration.gap.next_recording import next_recording
from tam_calibration.gap.probability import probabilities
from tam_calibration.gap.regression import Base
from tam_calibration.gap.result import Cause, Considered, Gap, Residue, Size, Verdict, Where
from tam_calibration.gap.search import Hypothesis, Place, places_of
from tam_calibration.gap.shares import shares_of
from tam_calibration.gap.size import LARGEST_NOISE, measure, noise_variance
from tam_calibration.gap.standing import LEAST_EVIDENCE, open_part, sensors_of
from tam_calibration.gap.steps import Search
from tam_calibration.gap.where import locate, main_places, sensors_and_axes
from tam_calibration.units import FloatArray

SMALLEST_GAP = 0.1
"""In noise floors; what is smaller is no gap, however certain."""

_PARTLY_CLOSED = 0.6

_LEFT = 0.22
"""Part of a gap's amplitude that true causes visibly leave in their own sensors at most."""

_MANY = 3
"""Causes, jumps counted singly, that together imitate much: they may leave half as much."""

_AS_GOOD = 10.0
_NEARLY_ALL = 0.97
"""Difference of BIC, and part of the evidence, within which two effects cannot be told apart."""

_FREE_WITHOUT = ("temperature_drift", "current_interference")
"""Effects that, while their channel is missing, may be any function of time."""

_OF_FEW, _FEW = ("saturation", "outliers"), 3
"""Effects that are alike in so few samples."""


def conclude(found: Search) -> Gap:
    """Return the gap that a search found."""
    variance = noise_variance(found.model, found.remaining, LEAST_EVIDENCE)
    noisier = None if found.steps else _noisier(found.nominal)
    if noisier is not None:
        variance = min(variance, noisier.floor)
    whole_nominal, whole = found.nominal.of_all_samples(), found.model.of_all_samples()
    size = measure(whole_nominal, whole, variance)
    base = found.nominal.base()
    verdict = _verdict(found, size, variance, noisier is not None)
    chances = probabilities(found, verdict)
    causes = _causes(found, whole, size, chances, variance)
    if verdict in ("no_gap", "unexplained"):
        causes, whole = (), whole_nominal
        size = measure(whole_nominal, whole, variance)
    places = [_places(cause.fitted) for cause in causes]
    where = (
        Where((), (), None, None, {})
        if verdict == "no_gap"
        else locate(base, places, found.rivals, variance, LEAST_EVIDENCE)
    )
    considered = _considered(found, causes)
    return Gap(
        verdict,
        size,
        where,
        causes,
        considered,
        chances,
        next_recording(found, verdict, causes, variance),
        _statement(verdict, size, where, causes),
        _residue(whole_nominal, whole, whole_nominal.channels(), variance),
    )


def _noisier(nominal: Model) -> Excess | None:
    """Return the excess of variance of some rows over the others, whatever makes it."""
    channels = nominal.channels()
    excess = best_excess(Moments.of(channels.misfit), channels.situation)
    if excess is None or excess.gain - excess.parameter_count * np.log(channels.count) < LEAST_EVIDENCE:
        return None
    return excess


def _verdict(found: Search, size: Size, variance: float, is_noisier: bool) -> Verdict:
    if size.before < SMALLEST_GAP:
        return "no_gap"
    strongest = max((rival.delta_bic for rival in found.remaining), default=0.0)
    left = open_part(found.nominal.base(), found.model.base(), found.remaining)
    if not found.steps:
        is_even = strongest < LEAST_EVIDENCE and variance < LARGEST_NOISE**2 and not is_noisier
        return "no_gap" if is_even else "unexplained"
    if size.closed < _PARTLY_CLOSED or _stands_in(found, size):
        return "unexplained"
    return "explained" if size.closed >= 1 - CLEAN or left < CLEAN else "partly_explained"


def _stands_in(found: Search, size: Size) -> bool:
    """Whether causes leave more in their own sensors than true ones would: they stand in for something else."""
    most = _LEFT if len(found.steps) < _MANY else _LEFT / 2
    strongest = max(found.remaining, key=lambda one: one.delta_bic, default=None)
    if size.closed >= 1 - most**2 or strongest is None or strongest.delta_bic < LEAST_EVIDENCE:
        return False
    own = {place for step in found.steps for place in sensors_of(places_of(step.accepted.form))}
    return ALL in own or sensors_of(main_places(found.model.base(), strongest)) <= own


def _causes(
    found: Search, model: Model, size: Size, chances: Mapping[str, float], variance: float
) -> tuple[Cause, ...]:
    linear = [step for step in found.steps if isinstance(step.accepted.form, Hypothesis)]
    by_finding = {
        id(step.accepted.form.fitted): step for step in reversed(found.steps) if isinstance(step.accepted.form, Finding)
    }
    others = list(by_finding.values())
    shares = shares_of(model) if model.parts else np.empty(0)
    fitted = _fitted(model, variance)
    gains = [step.accepted.gain for step in (*linear, *others)]
    total = max(sum(gains), 1e-300)
    linear_gain = sum(step.accepted.gain for step in linear)
    weights = [*(share * linear_gain / total for share in shares), *(step.accepted.gain / total for step in others)]
    causes = []
    for step, effect, weight in zip((*linear, *others), (*fitted, *_findings(model)), weights, strict=True):
        sensors, axes = sensors_and_axes(_places(effect), model.recording)
        causes.append(
            Cause(
                effect,
                _units(effect, step.accepted),
                sensors,
                axes,
                chances.get(effect.effect, 0.0),
                float(weight),
                step.accepted.delta_bic,
                float(size.closed * weight),
                _alike(step, effect, found),
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.share))


def _alike(step: Step, effect: FittedEffect, found: Search) -> tuple[str, ...]:
    """Return the effects that cannot be told from a cause: those that explain as much, or lack the channel to do so."""
    cause = step.accepted
    names = [
        rival.effect
        for rival in step.weighed
        if rival.effect != effect.effect
        and (rival.delta_bic > cause.delta_bic - _AS_GOOD or rival.gain > _NEARLY_ALL * cause.gain)
    ]
    if isinstance(cause.form, Hypothesis) and cause.form.effect.is_free_in_time:
        names += [
            one.effect for one in found.considered if one.status == "channel_missing" and one.effect in _FREE_WITHOUT
        ]
    is_few = isinstance(cause.form, Finding) and cause.form.flagged is not None and cause.form.flagged.sum() <= _FEW
    if is_few and effect.effect in _OF_FEW:
        names += [name for name in _OF_FEW if name != effect.effect]
    return tuple(dict.fromkeys(names))


def _fitted(model: Model, variance: float) -> list[FittedEffect]:
    """Return the effects that add to the rows with values and standard errors."""
    if not model.parts:
        return []
    channels = model.channels(model.signal())
    terms = [part.terms(channels) for part in model.parts]
    designs = [channels.design(own) for own in terms]
    projected = Base(channels, [channels.calibration]).project(Design.joined(designs))
    covariance = variance * projected.inverse()[0]
    ends = np.cumsum([design.width for design in designs])
    return [
        part.fitted(own, covariance[end - design.width : end, end - design.width : end])
        for part, own, design, end in zip(model.parts, terms, designs, ends, strict=True)
    ]


def _findings(model: Model) -> list[FittedEffect]:
    return list({id(finding.fitted): finding.fitted for finding in reversed(model.findings)}.values())


def _places(effect: FittedEffect) -> list[Place]:
    return list(dict.fromkeys((one.sensor, one.axis) for one in effect.contributions))


def _units(effect: FittedEffect, evidence: Evidence) -> dict[str, str]:
    form = evidence.form
    if isinstance(form, Hypothesis):
        units = {coefficient.name: coefficient.unit for term in form.terms for coefficient in term.coefficients}
        return units | dict(form.effect.shape_units)
    names = {name for one in effect.contributions for name in one.values}
    units = getattr(effect_named(effect.effect), "units", {})
    return {name: units.get(name, "T") for name in sorted(names)}


def _considered(found: Search, causes: tuple[Cause, ...]) -> tuple[Considered, ...]:
    named = {cause.fitted.effect for cause in causes}
    result = {one.effect: one for one in found.considered}
    for one in found.weighed:
        if one.effect in named:
            why = "the data ask for it"
            result[one.effect] = Considered(one.effect, "supported", why, one.delta_bic)
            continue
        why = (
            "noise alone explains the data as well"
            if one.delta_bic < LEAST_EVIDENCE
            else "what it could explain, another explains better"
        )
        result[one.effect] = Considered(one.effect, "not_supported", why, one.delta_bic)
    for cause in causes:
        result[cause.fitted.effect] = Considered(
            cause.fitted.effect, "supported", "the data ask for it", cause.delta_bic, cause.r2_cv
        )
    return tuple(result[name] for name in sorted(result))


def _statement(verdict: Verdict, size: Size, where: Where, causes: tuple[Cause, ...]) -> str:
    if verdict == "no_gap":
        return "No gap: what the calibration leaves is noise."
    told = f"A gap of {size.before:.2g} times the noise floor in {_named(where)}"
    if verdict == "unexplained":
        return f"{told} that no effect of the library explains."
    names = " and ".join(dict.fromkeys(cause.fitted.effect.replace("_", " ") for cause in causes))
    part = "explained" if verdict == "explained" else "partly explained"
    return f"{told}, {part} by {names}: {100 * size.closed:.0f} % of it closes."


def _named(where: Where) -> str:
    """Return the place in words."""
    numbers = [str(one) for one in where.sensors if isinstance(one, int)]
    parts = []
    if numbers:
        parts.append(f"sensor{'s' * (len(numbers) > 1)} {', '.join(numbers)}")
    if "scalar" in where.sensors:
        parts.append("the scalar magnetometer")
    return " and ".join(parts) or "all sensors"


def _residue(nominal: Model, model: Model, before: Channels, variance: float) -> Residue:
    after = model.base().channels
    array = nominal.array
    assert array.vector_noise_T is not None
    generator = np.random.default_rng(0)
    situation = before.situation
    scale = float(np.sqrt(variance))
    noise = generator.normal(size=(situation.sample_count, situation.sensor_count, 3)) * (
        scale * array.vector_noise_T[None, :, None]
    )
    direction = situation.field_T / situation.intensity_T[:, None]
    field_T: FloatArray = nominal.intensity_T * direction
    scalar = None
    if nominal.recording.scalar_T is not None:
        drawn = generator.normal(size=situation.sample_count) * (scale * (array.scalar_noise_T or 0.0))
        field_T, scalar = situation.field_T, np.where(before.precision > 0, situation.intensity_T + drawn, np.nan)
    readings = situation.errors.distort(field_T) + noise
    twin = Channels.at(
        replace(nominal.recording, readings_T=readings, scalar_T=scalar), array, nominal.errors, nominal.intensity_T
    )

    told = before.misfit.row_information
    typical = np.array([np.median(row[row > 0]) if row.any() else np.inf for row in told.T])

    def shifts(channels: Channels) -> FloatArray:
        information = channels.misfit.row_information
        shift: FloatArray = channels.misfit.row_shift_T * np.sqrt(information / typical)
        shift[information == 0] = np.nan
        return shift

    left = shifts(after)
    left[~model.is_counted] = np.nan
    floor = scale / np.sqrt(typical)
    return Residue(
        situation.time_s,
        direction,
        shifts(before),
        left,
        shifts(twin),
        floor,
        nominal.recording.temperature_C,
        nominal.recording.current_A,
    )
