"""From a search to the verdict on a gap, the sentence that says it, and what to record next."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tam_calibration.effects.grades import MINOR, MOST, NOTABLE
from tam_calibration.effects.library import effect_named
from tam_calibration.effects.noise_excess import LARGEST_NOISE
from tam_calibration.gap.causes import considered, locate, numbered_causes, placed, probabilities, set_of
from tam_calibration.gap.checks import checks_of
from tam_calibration.gap.laws.law import Signature, causes_of, in_words
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Cause, Gap, Residue, Size, Verdict, Where
from tam_calibration.gap.size import measure, noise_variance, words_of
from tam_calibration.gap.steps import LARGEST_REST, LEAST_EVIDENCE, Search
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.exceptions import sensors_in_words
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, rounded, to_nanotesla


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
    # A rest as large as the noise is a gap of its own.
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
    causes = numbered_causes(found, model, size, chances) if is_named else ()
    has_gap = verdict != "no_gap"
    gap = Gap(
        verdict,
        size,
        locate(found.nominal.base().channels, causes, found.laws, variance) if has_gap else Where(),
        causes,
        considered(found, causes),
        chances,
        next_recording(found, verdict, causes),
        "",
        residue,
        channel_count=channels.count,
        set_95=set_of(chances, verdict, causes),
        smallest_gap=smallest_gap(channels.count),
        checks=checks,
        remainder=_remainder(verdict, size),
        signature=_signature(found, causes) if has_gap else (),
        remaining=tuple(law.signature for law in found.remaining) if is_named else (),
    )
    return _stated(gap, found)


def _signature(found: Search, causes: Sequence[Cause]) -> tuple[Signature, ...]:
    """Return the laws of a gap, the strongest first: those of named causes at their places, and those that remain."""
    if not causes:
        return tuple(law.signature for law in found.laws)
    # One law may have two causes, such as steps at two times.
    of_causes = {(one.law.law, one.law.sensors, one.law.evidence): one.law for one in causes}
    return tuple(
        sorted([*of_causes.values(), *(law.signature for law in found.remaining)], key=lambda one: -one.energy)
    )


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
    size_of_gap = f"A gap of {rounded(gap.size.before)} times the noise floor in {where}"
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
    part = rounded(100 * (1 - size.closed))
    share = "All of the gap" if verdict == "unexplained" else f"{part} % of the gap's energy"
    left_nT = rounded(to_nanotesla(size.after_T), 3)
    return f"{share} is open: {rounded(size.after)} noise floors, {left_nT} nT at one axis of a sensor."


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
    direction = covariates.direction
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


_OTHERWISE = (
    "To see what the rest follows, make the same motion twice with a pause between, at half the rate, in the opposite "
    "sense, and at another place: what comes again goes with the array, what grows with the rate is a delay or a "
    "current that the turning drives, what turns round is a memory, what changes with the place belongs to the site."
)

_ENOUGH = (
    "No further recording is needed for this question; one more run of the same kind, kept out of the fit, would "
    "confirm the answer."
)


def next_recording(found: Search, verdict: Verdict, causes: Sequence[Cause]) -> str:
    """Say what to record next, and which channels with it.

    Parameters
    ----------
    found : Search
        Result of the search in this recording.
    verdict : str
        Of the diagnosis.
    causes : sequence of Cause
        The largest share first.
    """
    if verdict == "no_gap":
        return _ENOUGH
    recording = found.model.recording
    for cause in causes:
        if cause.indistinguishable_from:
            pair = cause.fitted.effect, cause.indistinguishable_from[0]
            return f"To tell {' from '.join(map(_words_of, pair))}, {_asked(recording, pair)}."
    if drifting := [one.fitted.effect for one in causes if one.is_drift]:
        return (
            f"Let the channel of {_words_of(drifting[0])} rise and fall several times in the run: in this one "
            "any other slow drift explains as much."
        )
    if verdict == "explained":
        return _ENOUGH
    laws = found.laws if verdict == "unexplained" else found.remaining
    possible = causes_of(laws[0].signature) if laws else ()
    hidden = {one.effect for one in found.considered if one.status in ("channel_missing", "not_identifiable")}
    for one in possible:
        if one.name in hidden:
            return f"To see whether it is {_words_of(one.name)}, {_asked(recording, [one.name])}."
    return f"To see whether it is “{possible[0].title}”, {possible[0].proof}." if possible else _OTHERWISE


def _words_of(effect: str) -> str:
    return effect.replace("_", " ")


def _asked(recording: Recording, names: Iterable[str]) -> str:
    """Return the motion that shows effects, with the channels that they need and that were not recorded."""
    effects = list(map(effect_named, names))
    motions = ", and ".join(dict.fromkeys(effect.excitation for effect in effects))
    needed = dict.fromkeys(channel for effect in effects for channel in effect.channels)
    missing = [words_of(channel) for channel in needed if recording.channel(channel) is None]
    return f"{motions}, with the {' and '.join(missing)} recorded" if missing else motions
