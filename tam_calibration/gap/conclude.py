"""From a search to the verdict on a gap, its causes with their numbers, and the sentence that says it."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tam_calibration.effects.covariates import Covariates
from tam_calibration.effects.effect import Finding, LinearEffect
from tam_calibration.effects.grades import MINOR, MOST, NEARLY_ALL, NOTABLE
from tam_calibration.effects.library import effect_named, units_of
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.gap.checks import checks_of
from tam_calibration.gap.hypothesis import Hypothesis, Place, sensors_of
from tam_calibration.gap.joint import Joint
from tam_calibration.gap.laws.law import agrees, in_words
from tam_calibration.gap.model import Model
from tam_calibration.gap.next_recording import next_recording
from tam_calibration.gap.probabilities import energies_of, probabilities, set_of, shares_of
from tam_calibration.gap.result import Cause, Considered, Gap, Residue, Size, Verdict, Where
from tam_calibration.gap.size import measure, noise_variance
from tam_calibration.gap.steps import LARGEST_REST, LEAST_EVIDENCE, Search, Step
from tam_calibration.gap.where import locate, placed, sensors_and_axes
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, FittedEffect
from tam_calibration.model.recording import Recording
from tam_calibration.model.sensors_in_words import sensors_in_words
from tam_calibration.model.units import FloatArray, to_nanotesla


def verdict_on(found: Search, size: Size) -> Verdict:
    """Return the verdict on a search.

    Parameters
    ----------
    found : Search
        Causes, the models without and with them, and the laws of what each leaves.
    size : Size
        Of the gap, before and after the causes.
    """
    if size.before < MINOR:
        return "no_gap"
    if not found.steps:
        is_noise = size.before**2 < LARGEST_NOISE**2 - 1
        return "no_gap" if is_noise and not found.laws else "unexplained"
    if size.closed < NOTABLE:  # Such a part may only be the correlation of the causes with an unknown one.
        return "unexplained"
    is_explained = found.explains_all and size.closed > MOST and size.after < LARGEST_REST
    return "explained" if is_explained else "partly_explained"


def smallest_gap(count: float) -> float:
    """Return the smallest detectable gap in so many channels, in noise floors: of one coefficient of one row."""
    return max(MINOR, float(np.sqrt((LEAST_EVIDENCE + np.log(count)) / count)))


def conclude(found: Search) -> Gap:
    """Return the gap that a search found."""
    variance = noise_variance(found.model, found.remaining)
    nominal, model = found.nominal.of_all_samples(), found.model.of_all_samples()
    size = measure(nominal, model, variance)
    verdict = verdict_on(found, size)
    is_named = verdict not in ("no_gap", "unexplained")
    if not is_named:
        model = nominal
        variance = noise_variance(found.nominal, found.laws)
        size = measure(nominal, model, variance)
    channels = nominal.channels()
    residue = residue_of(nominal, model, channels, variance)
    noise = model.recording.interpolated_noise
    checks = checks_of(residue.time_s, residue.direction, residue.after, residue.floor_T, noise)
    chances = probabilities(found, verdict, size, checks.departures)
    causes = _causes(found, model, size, chances) if is_named else ()
    has_gap = verdict != "no_gap"
    gap = Gap(
        verdict,
        size,
        locate(found.nominal.base().channels, causes, found.laws, variance) if has_gap else Where(),
        causes,
        _considered(found, causes),
        chances,
        next_recording(found, verdict, causes),
        "",
        residue,
        channel_count=channels.count,
        set_95=set_of(chances, verdict, causes),
        smallest_gap=smallest_gap(channels.count),
        checks=checks,
        remainder=_remainder(verdict, size),
        signature=found.signature if is_named else tuple(law.signature for law in found.laws) if has_gap else (),
        remaining=tuple(law.signature for law in found.remaining) if is_named else (),
    )
    return _stated(gap, found)


def _stated(gap: Gap, found: Search) -> Gap:
    """Return a gap with its sentence; one of the intensity alone at each of its places, with what separates them."""
    if not gap.signature or not gap.signature[0].is_common:
        where = sensors_in_words(gap.where.sensors) if gap.where.sensors else "all sensors"
        return replace(gap, statement=_statement(gap, where))
    places = gap.signature[0].places
    gap = placed(gap, gap.signature, places)
    where = in_words(places, found.nominal.recording.sensor_count, is_common=True)
    following = gap.next_recording if len(places) < 2 else f"{_APART} {gap.next_recording}"
    return replace(gap, statement=_statement(gap, where), next_recording=following)


def _statement(gap: Gap, where: str) -> str:
    """Return the verdict in one sentence, with the place of the gap in words."""
    if gap.verdict == "no_gap":
        return "No gap: what the calibration leaves is noise."
    size_of_gap = f"A gap of {gap.size.before:.2g} times the noise floor in {where}"
    if gap.verdict == "unexplained":
        return f"{size_of_gap} that no effect of the library explains."
    rival = " (or by anything else that changes as slowly)"
    names = dict.fromkeys(one.fitted.effect.replace("_", " ") + one.is_drift * rival for one in gap.causes)
    part = gap.verdict.replace("_", " ")
    return f"{size_of_gap}, {part} by {' and '.join(names)}: {100 * gap.size.closed:.0f} % of it closes."


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


def _causes(found: Search, model: Model, size: Size, chances: Mapping[str, float]) -> tuple[Cause, ...]:
    """Return the causes with their numbers, the largest share first.

    Linear effects share the energy that all of them explain; a finding has that of all steps that accepted it.
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
            sensors = step.law.sensors
        causes.append(
            Cause(
                effect,
                units_of(effect, model.errors, model.array),
                sensors,
                axes,
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
    courses = [
        getattr(recording, name) for name in ("temperature_C", "current_A") if name in effect_named(effect).channels
    ]
    return any(abs(_rank_correlation(course)) > NEARLY_ALL for course in courses)


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


def residue_of(nominal: Model, model: Model, before: WhitenedChannels, variance: float) -> Residue:
    """Return the residual of each row and sample before the causes, with them, and of a twin with noise alone.

    Parameters
    ----------
    nominal, model : Model
        Before the causes, and with them.
    before : WhitenedChannels
        Of the nominal model, all samples.
    variance : float
        Of the channels' white noise, over that of the array.
    """
    generator = np.random.default_rng(0)
    covariates, scale = before.covariates, float(np.sqrt(variance))
    noise = scale * nominal.row_noise_T * generator.normal(size=(covariates.sample_count, covariates.scalar_row))
    direction = covariates.field_T / covariates.intensity_T[:, None]
    field_T: FloatArray = nominal.intensity_T * direction
    scalar = None
    if nominal.recording.scalar_T is not None:
        drawn = scale * nominal.array.scalar_noise_T * generator.normal(size=covariates.sample_count)
        field_T, scalar = covariates.field_T, np.where(before.precision > 0, covariates.intensity_T + drawn, np.nan)
    exact = covariates.errors.distort(field_T)
    made = replace(nominal.recording, readings_T=exact + noise.reshape(exact.shape), scalar_T=scalar)
    twin = replace(nominal, recording=made).channels()
    typical = np.array([np.median(row[row > 0]) if row.any() else np.inf for row in before.residuals.row_information.T])

    def shifts(channels: WhitenedChannels) -> FloatArray:
        information = channels.residuals.row_information
        shift: FloatArray = channels.residuals.row_shift_T * np.sqrt(information / typical)
        shift[information == 0] = np.nan
        return shift

    before_T, after_T = shifts(before), shifts(model.base().channels)
    after_T[~model.is_counted] = np.nan
    return Residue(
        covariates.time_s,
        direction,
        before_T,
        after_T,
        shifts(twin),
        scale / np.sqrt(typical),
        nominal.recording.temperature_C,
        nominal.recording.current_A,
    )
