"""The causes of a gap: their numbers, places and probabilities, and where a gap without a cause lies."""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import cache
from itertools import permutations
from math import exp, log, log1p

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.grades import MINOR, MOST, NEARLY_ALL, NEGLIGIBLE, SLIGHT
from tam_calibration.effects.library import effect_named, units_of
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.effects.term import rows_of
from tam_calibration.gap.hypothesis import Hypothesis, Place, sensors_of
from tam_calibration.gap.joint import Joint
from tam_calibration.gap.laws.law import Place as LawPlace
from tam_calibration.gap.laws.law import Signature, acts_at, agrees
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.model import Model
from tam_calibration.gap.regression import Base
from tam_calibration.gap.regressors import Regressors
from tam_calibration.gap.result import Cause, Considered, Gap, Size, Verdict, Where
from tam_calibration.gap.steps import LEAST_EVIDENCE, Search, Step
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, SCALAR, FittedEffect
from tam_calibration.model.recording import Recording, is_further
from tam_calibration.model.units import FloatArray


def numbered_causes(found: Search, model: Model, size: Size, chances: Mapping[str, float]) -> tuple[Cause, ...]:
    """Return the causes with their numbers, the largest share first.

    Linear effects share the energy that all of them explain; a finding has that of all steps that accepted it.

    Parameters
    ----------
    found : Search
        With the steps that accepted the causes.
    model : Model
        With the causes, fitted to all samples.
    size : Size
        Of the gap.
    chances : mapping of str to float
        Probability of each effect.
    """
    energy = energies_of(found.steps, found.nominal.base().channels.count)
    total = sum(energy.values())
    linear = [step for step in found.steps if isinstance(step.accepted.form, Hypothesis)]
    of_linear = sum(energy[step] for step in linear) / total
    parts = zip(linear, Joint.of(model).effects, (of_linear * shares_of(model)).tolist(), strict=True)
    by_finding: dict[int, tuple[Step, FittedEffect, float]] = {}
    for step in found.steps:
        if isinstance(step.accepted.form, Finding):
            fitted = step.accepted.form.fitted
            first, _, before = by_finding.get(id(fitted), (step, fitted, 0.0))
            by_finding[id(fitted)] = first, fitted, before + energy[step] / total
    covariates = model.channels().covariates
    causes = []
    for step, effect, weight in (*parts, *by_finding.values()):
        places = _places(effect, covariates)
        sensors, axes = sensors_and_axes(places, model.recording)
        if isinstance(step.accepted.form, Finding) and ALL in sensors_of(places):
            sensors, axes = step.law.sensors, step.law.axes
            # The numbers are stated for the sensors that the law names.
            if "scalar" not in sensors and len(sensors) < model.recording.sensor_count:
                own = [replace(part, sensor=int(one) - 1) for part in effect.contributions for one in sensors]
                effect = replace(effect, contributions=tuple(own))
        elif len(sensors) == 1 and not acts_at(effect.effect, sensors):
            # What shows in one place alone, such as the scalar, acts in all.
            sensors, axes = sensors_and_axes([(ALL, None), (SCALAR, None)], model.recording)
        causes.append(
            Cause(
                effect,
                units_of(effect, model.errors, model.array),
                sensors,
                axes,
                step.law.at_place(sensors, axes),
                chances.get(effect.effect, 0.0),
                weight,
                step.accepted.delta_bic,
                size.closed * weight,
                _indistinguishable(step, found),
                is_drift(effect.effect, model.recording),
                tuple(effect_named(effect.effect).sizes(covariates, effect)),
            )
        )
    return tuple(sorted(causes, key=lambda cause: -cause.share))


def is_drift(effect: str, recording: Recording) -> bool:
    """Say whether the channel of an effect rises or falls throughout, so that any other slow course explains as much.

    Parameters
    ----------
    effect : str
        Name of an effect.
    recording : Recording
        Of N samples, with the channels of the effect.
    """
    channels = effect_named(effect).channels
    courses = [
        recording.channel(name) for name in channels if name in ("temperature_C", "current_A") or is_further(name)
    ]
    return any(course is not None and abs(_rank_correlation(course)) > NEARLY_ALL for course in courses)


def _rank_correlation(course: FloatArray) -> float:
    """Return the rank correlation of a course (N,) with its order in time (Spearman); equal values share a rank."""
    _, place, count = np.unique(course, return_inverse=True, return_counts=True)
    rank = (np.cumsum(count) - count / 2)[place]
    return float(np.corrcoef(np.arange(len(course)), rank)[0, 1])


def _indistinguishable(step: Step, found: Search) -> tuple[str, ...]:
    """Return the effects that the data do not separate from a cause, or whose channel is not recorded."""
    cause = step.accepted
    names = [*step.others]
    if isinstance(cause.form, Hypothesis) and cause.form.effect.is_free_in_time:
        names += [
            one.effect for one in found.considered if one.status == "channel_missing" and agrees(one.effect, step.law)
        ]
    return tuple(dict.fromkeys(names))


def _places(fitted: FittedEffect, covariates: Covariates) -> list[Place]:
    """Return the places of a fitted effect in which it is more than an error of its fit.

    The common field carries what is in one sensor over to others, and a large signal leaves a little in any row.
    """
    effect, parts = effect_named(fitted.effect), fitted.contributions
    if isinstance(effect, LinearEffect):
        rows = np.sqrt(np.mean(effect.signal(covariates, fitted) ** 2, axis=0))
        sensors = np.sqrt(np.mean(rows[:-1].reshape(-1, 3) ** 2, axis=1))
        parts = tuple(
            one
            for one in parts
            if rows[rows_of(one, covariates)].max() > NEGLIGIBLE * rows.max()
            and (one.sensor < 0 or sensors[one.sensor] > MINOR * sensors.max())
        )
    return list(dict.fromkeys((one.sensor, one.axis) for one in parts))


def considered(found: Search, causes: tuple[Cause, ...]) -> tuple[Considered, ...]:
    """Return the status of every hypothesis of a search, the causes among them, in the order of their names."""
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


def sensors_and_axes(places: Iterable[Place], recording: Recording) -> tuple[LawPlace, tuple[str, ...]]:
    """Return the sensor numbers (or "scalar") and axes of places.

    A constant intensity in place of a scalar channel counts as all sensors.

    Parameters
    ----------
    places : iterable of Place
        Index of the sensor, ``SCALAR`` or ``ALL``, and of the axis; None for all axes.
    recording : Recording
        Of K sensors, with or without a scalar channel.
    """
    places = [(ALL if sensor == SCALAR and recording.scalar_T is None else sensor, axis) for sensor, axis in places]
    found = {sensor for sensor, _ in places}
    found = found - {ALL} | set(range(recording.sensor_count)) if ALL in found else found
    sensors: LawPlace = (*(sensor + 1 for sensor in sorted(found - {SCALAR})), *["scalar"] * (SCALAR in found))
    axes = {axis for sensor, axis in places if sensor != SCALAR}
    return sensors, tuple(name for index, name in enumerate("xyz") if axes & {index, None})


def span_of(channels: WhitenedChannels, excess: FloatArray) -> tuple[float, float] | None:
    """Return the span, s, that holds nearly all energy in excess of noise, where it is a small part of the run.

    Parameters
    ----------
    channels : WhitenedChannels
        Of N samples, with their time stamps.
    excess : (N,) array
        Energy of each sample in excess of that expected of noise alone; 0 where a sample does not count.
    """
    total = np.cumsum(excess)
    if total[-1] <= 0:
        return None
    time_s, margin = channels.covariates.time_s, MINOR / 2
    ends = np.searchsorted(total, [margin * total[-1], (1 - margin) * total[-1]])
    low, high = time_s[np.minimum(ends, len(time_s) - 1)].tolist()
    return (low, high) if high - low < MOST * float(np.ptp(time_s)) else None


def locate(channels: WhitenedChannels, causes: Sequence[Cause], laws: Sequence[Law], variance: float) -> Where:
    """Return where the gap of a nominal model lies.

    Parameters
    ----------
    channels : WhitenedChannels
        Of the nominal model.
    causes : sequence of Cause
        Without any the place of the strongest law is returned.
    laws : sequence of Law
        Of the gap.
    variance : float
        Of the channels' white noise.
    """
    sensors = tuple(sorted({sensor for cause in causes for sensor in cause.sensors}, key=str))
    axes = tuple(axis for axis in "xyz" if any(axis in cause.axes for cause in causes))
    if not sensors and laws:
        sensors, axes = laws[0].signature.sensors, laws[0].signature.axes
    excess = (channels.energy_per_sample / variance - channels.channels_per_sample) * channels.is_counted
    known = channels.is_counted & (channels.precision > 0)
    per_channel = {
        "differential_chi_square": _mean(channels.differential[channels.is_counted] ** 2),
        "common_mode_chi_square": _mean(channels.precision[known] * channels.intensity_residual_T[known] ** 2),
    }
    return Where(sensors, axes, span_of(channels, excess), _line(laws, channels), per_channel)


def _line(laws: Sequence[Law], channels: WhitenedChannels) -> tuple[float, float] | None:
    """Return the band, Hz, that a recording resolves about the tone of the strongest law; None where that is none."""
    if not laws or laws[0].signature.course != "tone":
        return None
    width_hz = 1 / float(np.ptp(channels.covariates.time_s))
    frequency_hz = float(str(laws[0].signature.follows).split()[0])
    return max(frequency_hz - width_hz, 0.0), frequency_hz + width_hz


def _mean(values: FloatArray) -> float:
    """Return the mean, NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")


def placed(gap: Gap, laws: Sequence[Signature], places: Sequence[LawPlace]) -> Gap:
    """Return a gap that only the residual of the intensity shows at the likeliest of its places, and so its causes.

    Parameters
    ----------
    gap : Gap
        With its causes.
    laws : sequence of Signature
        The strongest first.
    places : sequence of Place
        Of the strongest law.
    """
    causes = tuple(_moved(one, laws, places[0]) for one in gap.causes)
    sensors = {sensor for one in causes for sensor in one.sensors} or set(places[0])
    axes = () if sensors == set(places[0]) else gap.where.axes
    where = replace(gap.where, sensors=tuple(sorted(sensors, key=str)), axes=axes)
    return replace(gap, causes=causes, where=where)


def _moved(cause: Cause, laws: Sequence[Signature], default: LawPlace) -> Cause:
    """Return a cause that acts on the scalar at the likeliest place of the strongest such law that it can make."""
    effect = cause.fitted.effect
    place = next((law.places[0] for law in laws if law.is_common and agrees(effect, law)), default)
    return replace(cause, sensors=place, axes=()) if "scalar" in cause.sensors and acts_at(effect, place) else cause


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
    left = np.exp(-np.cumsum([0.0, *(step.accepted.gain for step in steps)]) / count)
    return dict(zip(steps, (-np.diff(left)).tolist(), strict=True))


def shares_of(model: Model) -> FloatArray:
    """Return the Shapley values (M,) of the energy that the parts of a model explain; they add up to one."""
    count = len(model.parts)
    if count < 2:
        return np.ones(count)
    channels = model.channels()
    designs = [channels.design(part.terms(channels)) for part in model.parts]
    projected = Base(channels, [channels.calibration]).project(Regressors.joined(designs))
    ends = np.cumsum([design.width for design in designs])
    columns = np.split(np.arange(ends[-1]), ends[:-1])

    @cache
    def explained(group: frozenset[int]) -> float:
        return projected.take(np.concatenate([columns[member] for member in sorted(group)])).gain()[0]

    values = np.zeros(count)
    for order in permutations(range(count)):  # each part explains what those before it leave
        before = 0.0
        for size, member in enumerate(order, start=1):
            energy = explained(frozenset(order[:size]))
            values[member] += energy - before
            before = energy
    return np.maximum(values, 0) / max(float(np.maximum(values, 0).sum()), np.finfo(float).tiny)


_COEFFICIENTS = (-0.76, -0.45, 1.51, 0.4, -0.5)
"""Logistic regression: intercept, log(1 + failing checks), share, log ratio of the evidences, log of the open part.

``benchmarks/gap_probabilities.py`` fits them: to the 613 causes named in cases of ``tam blind make`` that were judged
before, with the ninth to the twelfth set of causes outside the library (``--seed 20271401``, 20271502, 20271602 and
20271702), and 90 of the library alone.
"""


_RIGHT: Mapping[Verdict, float] = {"no_gap": 35 / 38, "unexplained": 44 / 50}
"""Part of these verdicts that was right in the same cases: 34 of 36 and 43 of 48, by Laplace's rule."""


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
        own = right(features_of(departures, share, step.accepted.delta_bic, rival, size.closed))
        chances[step.accepted.effect] = max(own, chances.get(step.accepted.effect, 0.0))
    rest = 1 - min(chances[name] for name in named)
    chances["none_of_these"] = rest / 2
    _spread(chances, found, named, rest / 2)
    return chances


def right(features: Sequence[float]) -> float:
    """Return the probability that a cause is right, by the logistic regression."""
    return 1 / (1 + exp(-sum(w * value for w, value in zip(_COEFFICIENTS, features, strict=True))))


def features_of(departures: int, share: float, own: float, rival: float, closed: float) -> tuple[float, ...]:
    """Return the features of the logistic regression of a cause, in the order of the coefficients.

    Parameters
    ----------
    departures : int
        Number of predictive checks that the residual fails.
    share : float
        Of the cause in the energy that all causes explain.
    own, rival : float
        ΔBIC of the cause, and the largest of the effects that were not named.
    closed : float
        Part of the gap's energy that all causes close.
    """
    ratio = log(max(own, LEAST_EVIDENCE) / max(rival, LEAST_EVIDENCE))
    return 1.0, log1p(departures), share, ratio, log(1 - closed + NEGLIGIBLE)


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
    named = {cause.fitted.effect for cause in causes}
    ranked = sorted(chances, key=lambda name: -chances[name])
    members = [name for name in ranked if name in named]
    doubt = 1 - min((chances[name] for name in named), default=0.0)
    for name in ranked:
        if members and 1 - doubt >= 1 - SLIGHT:
            break
        if name not in named:
            members.append(name)
            doubt -= chances[name]
    return tuple("unknown" if name == "none_of_these" else name for name in members)


def _spread(chances: dict[str, float], found: Search, named: Collection[str], rest: float) -> None:
    """Distribute the remaining probability over the effects not named by their gains; without any to none of these."""
    gains = {one.effect: max(one.gain, 0.0) for one in found.weighed if one.effect not in named}
    total = sum(gains.values())
    if total == 0:
        chances["none_of_these"] += rest
        return
    for name, gain in gains.items():
        chances[name] += rest * gain / total
