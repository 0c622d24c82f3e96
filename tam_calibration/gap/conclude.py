"""From a search to the verdict."""

from collections.abc import Mapping

import numpy as np

from tam_calibration.effects.effect import Finding, FittedEffect, LinearEffect, Situation
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.effects.grades import FEWEST, MINOR, NEARLY_ALL
from tam_calibration.effects.library import effect_named
from tam_calibration.gap.checks import checks_of
from tam_calibration.gap.coloured import sandwich, unseen
from tam_calibration.gap.hypotheses import Evidence
from tam_calibration.gap.model import Model
from tam_calibration.gap.next_recording import next_recording
from tam_calibration.gap.probability import probabilities, set_of
from tam_calibration.gap.regression import Base
from tam_calibration.gap.remainder import describe
from tam_calibration.gap.residue import residue_of
from tam_calibration.gap.result import Cause, Considered, Gap, Size, Where
from tam_calibration.gap.search import Hypothesis, Place, sensors_of
from tam_calibration.gap.shares import energies_of, shares_of
from tam_calibration.gap.size import measure, noise_variance
from tam_calibration.gap.steps import Search
from tam_calibration.gap.support import LEAST_EVIDENCE, Step
from tam_calibration.gap.verdict import noisier_rows, smallest_gap, statement, verdict_on
from tam_calibration.gap.where import locate, sensors_and_axes

_FREE_WITHOUT = ("temperature_drift", "current_interference")
"""Effects that, while their channel is missing, may be any function of time."""

_OF_FEW = ("saturation", "outliers")
"""Effects that are alike in the fewest samples: a spike or three may as well be the end of a range."""


def conclude(found: Search) -> Gap:
    """Return the gap that a search found."""
    variance = noise_variance(found.model, found.remaining, LEAST_EVIDENCE)
    noisier = None if found.steps else noisier_rows(found.nominal)
    if noisier is not None:
        variance = min(variance, max(noisier.floor, LARGEST_NOISE**-2))
    whole_nominal, whole = found.nominal.of_all_samples(), found.model.of_all_samples()
    size = measure(whole_nominal, whole, variance)
    base = found.nominal.base()
    verdict = verdict_on(found, size, variance, noisier is not None)
    is_named = verdict not in ("no_gap", "unexplained")
    if not is_named:
        whole = whole_nominal
        size = measure(whole_nominal, whole, variance)
    residue = residue_of(whole_nominal, whole, whole_nominal.channels(), variance)
    checks = checks_of(residue.time_s, residue.direction, residue.after, residue.floor_T)
    chances = probabilities(found, verdict, checks.departures)
    causes = _causes(found, whole, size, chances, variance) if is_named else ()
    places = [_places(cause.fitted, base.channels.situation) for cause in causes]
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
        statement(verdict, size, where, causes),
        residue,
        channel_count=whole_nominal.channels().count,
        set_95=set_of(chances, verdict, causes),
        smallest_gap=smallest_gap(whole_nominal.channels().count),
        checks=checks,
        remainder=describe(found, verdict, size, residue, variance),
    )


def _causes(
    found: Search, model: Model, size: Size, chances: Mapping[str, float], variance: float
) -> tuple[Cause, ...]:
    linear = [step for step in found.steps if isinstance(step.accepted.form, Hypothesis)]
    by_finding: dict[int, list[Step]] = {}
    for step in found.steps:
        if isinstance(step.accepted.form, Finding):
            by_finding.setdefault(id(step.accepted.form.fitted), []).append(step)
    others = [steps[0] for steps in by_finding.values()]
    shares = shares_of(model) if model.parts else np.empty(0)
    fitted = _fitted(model)
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    total = sum(energy.values())
    linear_energy = sum(energy[step] for step in linear)
    weights = [
        *(share * linear_energy / total for share in shares),
        *(sum(energy[step] for step in steps) / total for steps in by_finding.values()),
    ]
    situation = model.channels().situation
    causes = []
    for step, effect, weight in zip((*linear, *others), (*fitted, *_findings(model)), weights, strict=True):
        sensors, axes = sensors_and_axes(_places(effect, situation), model.recording)
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
                step.standing,
                tuple(effect_named(effect.effect).sizes(situation, effect)),
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
        and (rival.delta_bic > cause.delta_bic - LEAST_EVIDENCE or rival.gain > NEARLY_ALL * cause.gain)
    ]
    if isinstance(cause.form, Hypothesis) and cause.form.effect.is_free_in_time:
        names += [
            one.effect for one in found.considered if one.status == "channel_missing" and one.effect in _FREE_WITHOUT
        ]
    is_few = isinstance(cause.form, Finding) and cause.form.flagged is not None and cause.form.flagged.sum() < FEWEST
    if is_few and effect.effect in _OF_FEW:
        names += [name for name in _OF_FEW if name != effect.effect]
    return tuple(dict.fromkeys(names))


def _fitted(model: Model) -> list[FittedEffect]:
    """Return the effects that add to the rows with values and standard errors."""
    if not model.parts:
        return []
    channels = model.channels(model.signal())
    terms = [part.terms(channels) for part in model.parts]
    designs = [channels.design(own) for own in terms]
    base = Base(channels, [channels.calibration])
    covariance = sandwich(base, designs)
    left_out = [term for part in model.parts for term in part.left_out(channels)]
    if left_out:
        covariance = covariance + unseen(base, designs, channels.design(left_out))
    ends = np.cumsum([design.width for design in designs])
    return [
        part.fitted(own, covariance[end - design.width : end, end - design.width : end])
        for part, own, design, end in zip(model.parts, terms, designs, ends, strict=True)
    ]


def _findings(model: Model) -> list[FittedEffect]:
    return list({id(finding.fitted): finding.fitted for finding in model.findings}.values())


def _places(fitted: FittedEffect, situation: Situation) -> list[Place]:
    """Return the places of a fitted effect, sensors left out that only get what the common field hands on to them."""
    effect = effect_named(fitted.effect)
    places = list(dict.fromkeys((one.sensor, one.axis) for one in fitted.contributions))
    if not isinstance(effect, LinearEffect) or len(sensors_of(places)) < 2:
        return places
    rows = np.sqrt(np.mean(effect.signal(situation, fitted)[:, :-1] ** 2, axis=0))
    size = np.sqrt(np.mean(rows.reshape(-1, 3) ** 2, axis=1))
    return [place for place in places if place[0] < 0 or size[place[0]] > MINOR * size.max()]


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
