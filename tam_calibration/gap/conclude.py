"""From a search to the verdict on a gap, and the sentence that says it.

It tells the share of each cause in the energy that all explain, and the calibrated probabilities of the answers.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from itertools import combinations
from math import exp, expm1, factorial, log, log1p

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.excess_variance import LARGEST_NOISE
from tam_calibration.effects.grades import FEWEST, MINOR, MOST, NOTABLE, SLIGHT
from tam_calibration.effects.library import effect_named, installed_effects, units_of
from tam_calibration.gap.checks import checks_of
from tam_calibration.gap.coloured import covariance_of
from tam_calibration.gap.hypothesis import Hypothesis, Place, sensors_of
from tam_calibration.gap.laws.causes import agrees
from tam_calibration.gap.laws.law import in_words
from tam_calibration.gap.model import Model
from tam_calibration.gap.next_recording import is_drift, next_recording
from tam_calibration.gap.placed import placed
from tam_calibration.gap.regression import Base
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.residue import residue_of
from tam_calibration.gap.result import Cause, Considered, Gap, Size, Verdict, Where
from tam_calibration.gap.search import LARGEST_REST, Search
from tam_calibration.gap.size import measure, noise_variance
from tam_calibration.gap.support import LEAST_EVIDENCE, Step
from tam_calibration.gap.where import locate, sensors_and_axes
from tam_calibration.model.fitted_effect import ALL, FittedEffect
from tam_calibration.model.sensors_in_words import numbered
from tam_calibration.model.units import FloatArray, to_nanotesla


def energies_of(steps: Sequence[Step], count: float) -> dict[Step, float]:
    """Return the part of the energy that each cause explains of the residual of those accepted before it.

    Parameters
    ----------
    steps : sequence of Step
        Causes in the order in which they were accepted.
    count : float
        Number of whitened channels.

    Returns
    -------
    dict of Step to float
        As a part of the residual energy before the first cause, 0 to 1.
    """
    left, energies = 1.0, {}
    for step in steps:
        energies[step] = left * -expm1(-step.accepted.gain / count)
        left -= energies[step]
    return energies


def shares_of(model: Model) -> FloatArray:
    """Return the Shapley values (M,) of the energy that the parts of a model explain; they add up to one."""
    count = len(model.parts)
    if count < 2:
        return np.ones(count)
    channels = model.channels()
    designs = [channels.design(part.terms(channels)) for part in model.parts]
    projected = Base(channels, [channels.calibration]).project(Regressors.joined(designs))
    ends = np.cumsum([design.width for design in designs])
    columns = [np.arange(end - design.width, end) for end, design in zip(ends, designs, strict=True)]
    explained: dict[tuple[int, ...], float] = {(): 0.0}
    for size in range(1, count + 1):
        for group in combinations(range(count), size):
            explained[group] = projected.take(np.concatenate([columns[member] for member in group])).gain()[0]
    values = np.zeros(count)
    for group, energy in explained.items():
        for member in group:
            others = tuple(other for other in group if other != member)
            weight = factorial(len(others)) * factorial(count - len(group)) / factorial(count)
            values[member] += weight * (energy - explained[others])
    return np.maximum(values, 0) / max(float(np.maximum(values, 0).sum()), np.finfo(float).tiny)


_COEFFICIENTS = (1.24, -1.18, 2.0, 0.83)
"""Logistic regression: intercept, log(1 + failing checks), share, and log ratio of the evidences."""

_RIGHT: Mapping[Verdict, float] = {"no_gap": 167 / 171, "unexplained": 228 / 242}
"""Part of these verdicts that was right: 166 of 169 and 227 of 240, by Laplace's rule."""

_NAMES = {"none_of_these": "unknown"}


def probabilities(found: Search, verdict: Verdict, size: Size, departures: int) -> Mapping[str, float]:
    """Return the probabilities of no gap, of each effect that was weighed, and of none of these.

    They add up to one; of several causes each has a probability of its own.

    Parameters
    ----------
    found : Search
        Causes, and the evidence for every effect at the nominal model.
    verdict : str
        Of the diagnosis.
    size : Size
        Of the gap.
    departures : int
        Number of predictive checks that the residual fails.
    """
    chances = dict.fromkeys(("no_gap", *(one.effect for one in found.weighed), "none_of_these"), 0.0)
    if verdict in ("no_gap", "unexplained"):
        answer, other = ("no_gap", "none_of_these") if verdict == "no_gap" else ("none_of_these", "no_gap")
        # More than noise that exceeds its sheet is a gap.
        rest = 1 - _RIGHT[verdict]
        part = rest if not found.weighed else rest / 2 if size.before**2 < LARGEST_NOISE**2 - 1 else 0.0
        chances[answer] = _RIGHT[verdict]
        chances[other] += part
        _spread(chances, found, (), rest - part)
        return chances
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    named = tuple({step.accepted.effect: None for step in found.steps})
    rival = max((one.delta_bic for one in found.weighed if one.effect not in named), default=0.0)
    for step in found.steps:
        share = energy[step] / sum(energy.values())
        own = right(features_of(departures, share, step.accepted.delta_bic, rival))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(features: Sequence[float]) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    return 1 / (1 + exp(-sum(w * value for w, value in zip(_COEFFICIENTS, features, strict=True))))


def features_of(departures: int, share: float, own: float, rival: float) -> tuple[float, float, float, float]:
    """Return the features of the logistic regression of a cause, in the order of the coefficients.

    Parameters
    ----------
    departures : int
        Number of predictive checks that the residual fails.
    share : float
        Of the cause in the energy that all causes explain.
    own, rival : float
        ΔBIC of the cause, and the largest of the effects that were not named.
    """
    return 1.0, log1p(departures), share, log(max(own, LEAST_EVIDENCE) / max(rival, LEAST_EVIDENCE))


def set_of(chances: Mapping[str, float], verdict: Verdict, causes: Collection[Cause]) -> tuple[str, ...]:
    """Return the smallest set of answers that holds the true one with 95 %, the most probable first.

    Of several causes the set holds all, then alternatives to the least probable of them.

    Parameters
    ----------
    chances : mapping of str to float
        As of ``probabilities``.
    verdict : str
        Of the diagnosis.
    causes : collection of Cause
        Those that the verdict names.
    """
    if verdict == "not_identifiable":
        return ()
    named = [cause.fitted.effect for cause in causes]
    ranked = sorted(chances, key=lambda name: (name not in named, -chances[name]))
    doubt, members = 1.0, []
    for name in ranked:
        members.append(_NAMES.get(name, name))
        if name in named:
            doubt = 1 - min(chances[one] for one in named)
            if len(members) < len(set(named)):
                continue
        else:
            doubt -= chances[name]
        if 1 - doubt >= 1 - SLIGHT:
            break
    return tuple(members)


def _spread(chances: dict[str, float], found: Search, named: Collection[str], rest: float) -> None:
    """Distribute the remaining probability over the effects not named by their gains; without any to none of these."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    if total == 0:
        chances["none_of_these"] += rest
    for name, gain in gains.items():
        chances[name] += rest * gain / total if total > 0 else 0.0


def verdict_on(found: Search, size: Size, variance: float) -> Verdict:
    """Return the verdict on a search.

    Parameters
    ----------
    found : Search
        Causes, the models without and with them, and the laws of what each leaves.
    size : Size
        Of the gap, before and after the causes.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    if size.before < MINOR:
        return "no_gap"
    if not found.steps:
        return "no_gap" if not found.laws and variance < LARGEST_NOISE**2 else "unexplained"
    if size.closed < NOTABLE:  # Such a part may only be the correlation of the causes with an unknown one.
        return "unexplained"
    is_whole = found.is_whole and size.closed > MOST and size.after < LARGEST_REST
    return "explained" if is_whole else "partly_explained"


def smallest_gap(count: float) -> float:
    """Return the smallest detectable gap in so many channels, in noise floors: of one coefficient of one row."""
    return max(MINOR, float(np.sqrt((LEAST_EVIDENCE + np.log(count)) / count)))


def statement(verdict: Verdict, size: Size, where: str, causes: tuple[Cause, ...]) -> str:
    """Return the verdict in one sentence.

    Parameters
    ----------
    verdict : str
        Of the diagnosis.
    size : Size
        Of the gap, before and after the causes.
    where : str
        Place of the gap in words.
    causes : tuple of Cause
        Ranked; they are named unless the verdict is that there is no gap or no explanation.
    """
    if verdict == "no_gap":
        return "No gap: what the calibration leaves is noise."
    size_of_gap = f"A gap of {size.before:.2g} times the noise floor in {where}"
    if verdict == "unexplained":
        return f"{size_of_gap} that no effect of the library explains."
    names = " and ".join(dict.fromkeys(map(_cause_in_words, causes)))
    part = "explained" if verdict == "explained" else "partly explained"
    return f"{size_of_gap}, {part} by {names}: {100 * size.closed:.0f} % of it closes."


def _cause_in_words(cause: Cause) -> str:
    rival = " (or by anything else that changes as slowly)" if cause.is_drift else ""
    return f"{cause.fitted.effect.replace('_', ' ')}{rival}"


def _named(where: Where) -> str:
    """Return the place in words."""
    numbers = [one for one in where.sensors if isinstance(one, int)]
    parts = [numbered(numbers)] if numbers else []
    parts += ["the scalar magnetometer"] * ("scalar" in where.sensors)
    return " and ".join(parts) or "all sensors"


def conclude(found: Search) -> Gap:
    """Return the gap that a search found."""
    variance = noise_variance(found.model, found.remaining)
    nominal, model = found.nominal.of_all_samples(), found.model.of_all_samples()
    size = measure(nominal, model, variance)
    base = found.nominal.base()
    verdict = verdict_on(found, size, variance)
    is_named = verdict not in ("no_gap", "unexplained")
    if not is_named:
        model = nominal
        variance = noise_variance(found.nominal, found.laws)
        size = measure(nominal, model, variance)
    residue = residue_of(nominal, model, nominal.channels(), variance)
    noise = model.recording.interpolated_noise
    checks = checks_of(residue.time_s, residue.direction, residue.after, residue.floor_T, noise)
    chances = probabilities(found, verdict, size, checks.departures)
    causes = _causes(found, model, size, chances, variance) if is_named else ()
    has_gap = verdict != "no_gap"
    gap = Gap(
        verdict,
        size,
        locate(base.channels, causes, found.laws, variance) if has_gap else Where(),
        causes,
        _considered(found, causes),
        chances,
        next_recording(found, verdict, causes),
        "",
        residue,
        channel_count=nominal.channels().count,
        set_95=set_of(chances, verdict, causes),
        smallest_gap=smallest_gap(nominal.channels().count),
        checks=checks,
        remainder=_remainder(verdict, size),
        signature=found.signature if has_gap else (),
        remaining=tuple(law.signature for law in found.remaining) if is_named else (),
    )
    return _stated(gap, found)


def _stated(gap: Gap, found: Search) -> Gap:
    """Return a gap with its sentence; one of the intensity alone at each of its places, with what tells them apart."""
    if not gap.signature or not gap.signature[0].is_common:
        return replace(gap, statement=statement(gap.verdict, gap.size, _named(gap.where), gap.causes))
    places = gap.signature[0].places
    gap = placed(gap, gap.signature, places)
    where = in_words(places, found.nominal.recording.sensor_count, is_common=True)
    following = gap.next_recording if len(places) < 2 else f"{_APART} {gap.next_recording}"
    return replace(gap, statement=statement(gap.verdict, gap.size, where, gap.causes), next_recording=following)


_APART = (
    "To tell the scalar from the field at all sensors, record the attitude, a base station or a second scalar, or give "
    "--place."
)


def _remainder(verdict: Verdict, size: Size) -> str:
    """Return in one sentence how much of the gap is open; empty where nothing is."""
    if verdict not in ("partly_explained", "unexplained"):
        return ""
    share = "All of the gap" if verdict == "unexplained" else f"{100 * (1 - size.closed):.2g} % of the gap's energy"
    return (
        f"{share} is open: {size.after:.2g} noise floors, {to_nanotesla(size.after_T):.3g} nT at one axis of a sensor."
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
    findings = {id(finding.fitted): finding.fitted for finding in model.findings}.values()
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    total = sum(energy.values())
    linear_energy = sum(energy[step] for step in linear)
    weights = [
        *(share * linear_energy / total for share in shares),
        *(sum(energy[step] for step in steps) / total for steps in by_finding.values()),
    ]
    covariates = model.channels().covariates
    causes = []
    for step, effect, weight in zip((*linear, *others), (*fitted, *findings), weights, strict=True):
        places = _places(effect, covariates)
        sensors, axes = sensors_and_axes(places, model.recording)
        if isinstance(step.accepted.form, Finding) and ALL in sensors_of(places):
            sensors = step.law.sensors
        causes.append(
            Cause(
                effect,
                units_of(effect, model.errors, model.array),
                sensors,
                axes,
                chances.get(effect.effect, 0.0),
                float(weight),
                step.accepted.delta_bic,
                float(size.closed * weight),
                _indistinguishable(step, effect, found),
                is_drift(effect.effect, model.recording),
                tuple(effect_named(effect.effect).sizes(covariates, effect)),
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.share))


def _indistinguishable(step: Step, effect: FittedEffect, found: Search) -> tuple[str, ...]:
    """Return the effects that cannot be told from a cause: they explain as much, or their channel is not recorded."""
    cause = step.accepted
    names = [*step.others]
    if isinstance(cause.form, Hypothesis) and cause.form.effect.is_free_in_time:
        names += [
            one.effect for one in found.considered if one.status == "channel_missing" and agrees(one.effect, step.law)
        ]
    is_few = isinstance(cause.form, Finding) and cause.form.flagged is not None and cause.form.flagged.sum() < FEWEST
    if is_few and effect_named(effect.effect).is_of_extremes:
        names += [one.name for one in installed_effects().values() if one.is_of_extremes and one.name != effect.effect]
    return tuple(dict.fromkeys(names))


def _fitted(model: Model) -> list[FittedEffect]:
    """Return the effects that add to the rows with values and standard errors."""
    if not model.parts:
        return []
    channels = model.channels(model.signal())
    terms = [part.terms(channels) for part in model.parts]
    designs = [channels.design(own) for own in terms]
    left_out = [term for part in model.parts for term in part.left_out(channels)]
    covariance = covariance_of(Base(channels, [channels.calibration]), designs, left_out)
    ends = np.cumsum([design.width for design in designs])
    return [
        part.fitted(own, covariance[end - design.width : end, end - design.width : end])
        for part, own, design, end in zip(model.parts, terms, designs, ends, strict=True)
    ]


def _places(fitted: FittedEffect, covariates: Covariates) -> list[Place]:
    """Return the places of a fitted effect without sensors whose signal is only carried over by the common field."""
    effect = effect_named(fitted.effect)
    places = list(dict.fromkeys((one.sensor, one.axis) for one in fitted.contributions))
    if not isinstance(effect, LinearEffect) or len(sensors_of(places)) < 2:
        return places
    rows = np.sqrt(np.mean(effect.signal(covariates, fitted)[:, :-1] ** 2, axis=0))
    size = np.sqrt(np.mean(rows.reshape(-1, 3) ** 2, axis=1))
    return [place for place in places if place[0] < 0 or size[place[0]] > MINOR * size.max()]


def _considered(found: Search, causes: tuple[Cause, ...]) -> tuple[Considered, ...]:
    result = {one.effect: one for one in found.considered}
    for one in found.weighed:
        if one.delta_bic < LEAST_EVIDENCE:
            why = "noise alone explains the data as well"
        else:
            why = "it leaves a part of the law, or another effect explains it better"
        result[one.effect] = Considered(one.effect, "not_supported", why, one.delta_bic)
    for cause in causes:
        result[cause.fitted.effect] = Considered(
            cause.fitted.effect, "supported", "the data ask for it", cause.delta_bic, cause.r2_cv
        )
    return tuple(result[name] for name in sorted(result))
