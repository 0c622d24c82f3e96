"""A calibration with effects: the errors of the sensors and what the effects add, fitted together and kept together.

Their uncertainty is that of both together, from the residual as it is.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np

from tam_calibration.correction.acceptance import within_limits
from tam_calibration.correction.calibration import Calibration
from tam_calibration.effects.effect import Effect, LinearEffect
from tam_calibration.effects.library import effect_named, installed_effects, shown_by
from tam_calibration.effects.removal import filled, linear_effect, removable
from tam_calibration.fit import calibrate
from tam_calibration.fit.consistency import LEAVE_OUT, LOOK_FOR_CAUSE, PARTS_APART, SOMETHING_MAGNETIC
from tam_calibration.fit.estimate import make_calibration
from tam_calibration.fit.identifiability import refuse_open, require_determined
from tam_calibration.fit.screening import sound_readings, without_bad_readings
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.diagnose import diagnose
from tam_calibration.gap.hypothesis import EVERYWHERE, Hypothesis, Part, refined
from tam_calibration.gap.joint import NO_SIZE, Joint
from tam_calibration.gap.laws.signature import times_of
from tam_calibration.gap.model import Model
from tam_calibration.gap.result import Gap
from tam_calibration.gap.search import Progress, search
from tam_calibration.gap.size import Evidence, examine, unusable
from tam_calibration.gap.steps import LEAST_EVIDENCE, Search
from tam_calibration.integrity import CHANNEL_FAULTS
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused, sensors_in_words
from tam_calibration.model.fitted_effect import FittedEffect
from tam_calibration.model.recording import Recording, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors, measure_residuals
from tam_calibration.model.units import FloatArray, to_nanotesla

IN_WORLD = "recorded_attitude"
"""Method of a calibration of one sensor in the field of the world."""

_AUTO = "auto"
"""Given instead of names: the effects that a diagnosis finds."""


_FOR_SIMULATIONS = "kept for simulations, and not taken off corrected data"

_BY_ATTITUDE = "known beside the attitude, and left in corrected data, where it takes less off than noise adds"


def calibrate_with_effects(
    recording: Recording,
    array: Array,
    effects: Collection[str],
    *,
    accept: Collection[str] = (),
) -> Calibration:
    """Fit the errors of an array's sensors together with effects, by maximum likelihood.

    Parameters
    ----------
    recording : Recording
        Samples in a uniform field, with the channels that the effects need.
    array : Array
        Geometry and noise.
    effects : collection of str
        Names of effects, or "auto" alone for those that a diagnosis finds.
    accept : collection of str
        Names of findings that shall refuse nothing: ``tam_calibration.integrity.ACCEPTABLE``.

    Returns
    -------
    Calibration
        With the effects. Its covariance includes their uncertainty. Residuals are those of readings without what the
        effects add; for held-out samples too the effects are those fitted to the complete recording.

    Raises
    ------
    InputError
        When the recording cannot be used, an effect is not known or lacks a channel.
    Refused
        When the recording cannot show an effect, or shows none of it, or its channels are not those of sound sensors.

    Examples
    --------
    >>> from tam_calibration import calibrate_with_effects, read_scenario, simulate
    >>> made = simulate(read_scenario("warming_up"))
    >>> calibration = calibrate_with_effects(made.recording, made.scenario.array, ["auto"])
    >>> [fitted.effect.replace("_", " ") for fitted in calibration.effects]
    ['temperature drift']
    """
    for name in set(effects) - {_AUTO}:
        effect_named(name)
    if _AUTO in effects and len(effects) > 1:
        raise InputError(f"{_AUTO} stands for all effects that are found: name no others beside it")
    array.require_recording(recording)
    sought = shown_by(installed_effects() if _AUTO in effects else effects)
    _, _, faults = sound_readings(recording, array, accept, sought)
    findings = [fault.sentence for fault in faults if fault.severity != "note"]
    recording.check_plausible(array.field)
    if recording.sensor_count > 1 or recording.attitude is None:  # else the attitude may determine what these do not
        with suppress(Refused):  # where readings contradict each other, effects may explain it
            require_determined(recording, array, has_effects=True)
    if _AUTO in effects:
        found = search(recording, array)
        return calibration_of(recording, found, conclude(found), array, warnings=findings, accept=accept)
    model, notes, warnings = _beside_bad_readings(recording, array, effects)
    calibration = _kept(model, array, (*findings, *warnings), accept, filled(recording).attitude)
    return replace(calibration, notes=(*notes, *calibration.notes))


def calibration_of(
    recording: Recording,
    found: Search,
    gap: Gap,
    array: Array,
    *,
    warnings: Sequence[str] = (),
    accept: Collection[str] = (),
) -> Calibration:
    """Return the calibration with the effects that a diagnosis found.

    Parameters
    ----------
    recording : Recording
        That was searched.
    found : Search
        Causes, and the models without and with them.
    gap : Gap
        What was concluded of them.
    array : Array
        As it was given.
    warnings : sequence of str
        What the calibration warns of besides.
    accept : collection of str
        Names of findings that shall refuse nothing.

    Raises
    ------
    InputError, Refused
        When the samples determine no calibration, or one that no sensor has.
    """
    model = found.nominal if gap.verdict == "no_gap" else found.model
    left = (gap.statement,) if gap.verdict in ("partly_explained", "unexplained") else ()
    if model.parts or model.findings or model.world is not None:
        return _kept(model, array, (*warnings, *left), accept, filled(recording).attitude)
    calibration = calibrate(recording, array, accept=accept)
    return replace(calibration, warnings=(*calibration.warnings, *left))


def _beside_bad_readings(
    recording: Recording, array: Array, names: Collection[str]
) -> tuple[Model, tuple[str, ...], tuple[str, ...]]:
    """Return the model of readings that named effects explain, which others were left out, and warnings.

    A bad reading bends calibration and effects, and what effects add is no bad reading: both are found in turn.
    """
    model, warnings = _with_named(recording, array, names)
    notes: tuple[str, ...] = ()
    place = np.zeros(0, dtype=int)
    for _ in range(8):  # two or three are enough where effects and bad readings differ
        if model.findings or model.world is not None:  # those say themselves which samples count
            break
        quiet = replace(model, recording=filled(recording)).quiet()
        _, left_out = without_bad_readings(quiet, array)
        if left_out is None or not left_out.is_brief or left_out.is_lasting or np.array_equal(left_out.place, place):
            break
        notes, place = tuple(left_out.sentences()), left_out.place
        model, warnings = _with_named(recording.take(np.delete(np.arange(quiet.sample_count), place)), array, names)
    return model, notes, warnings


def _with_named(recording: Recording, array: Array, names: Collection[str]) -> tuple[Model, tuple[str, ...]]:
    """Return the model with the named effects accepted, the strongest first, and warnings of those without evidence."""
    model = Model.nominal(recording, array)
    waiting, warnings = {name: effect_named(name) for name in names}, []
    if any("attitude" in effect.channels for effect in waiting.values()):
        model = model.aligned()
    for effect in waiting.values():
        reason = unusable(effect, model.recording, model.channels().covariates)
        if reason is None:
            continue
        if reason.status == "channel_missing":
            raise InputError(f"{effect.name} cannot be fitted: it {reason.why}")
        raise Refused(f"{effect.name} cannot be told from this recording: {reason.why}; {effect.excitation}")
    while waiting:
        base = model.base()
        times = times_of(model) if any(map(_comes_and_goes, waiting.values())) else ()
        examined = {name: examine(base, effect, EVERYWHERE, times) for name, effect in waiting.items()}
        visible = [one for one in examined.values() if isinstance(one, Evidence)]
        if not visible:
            name, why = next((name, why) for name, why in examined.items() if isinstance(why, str))
            raise Refused(f"{name} is not in this recording: {why}; calibrate without it")
        best = max(visible, key=lambda one: one.delta_bic)
        if best.delta_bic < LEAST_EVIDENCE:
            warnings.append(f"noise alone explains the recording as well as {best.effect}: leave this effect out")
        form = refined(base, best.form) if isinstance(best.form, Hypothesis) else best.form
        model = model.accept(form)
        del waiting[best.effect]
    return model, tuple(warnings)


def _comes_and_goes(effect: Effect) -> bool:
    """Say whether the times of laws, which are dear to find, give an effect shapes."""
    return isinstance(effect, LinearEffect) and type(effect).shapes_at is not LinearEffect.shapes_at


def _kept(
    model: Model, array: Array, warnings: tuple[str, ...], accept: Collection[str], attitude: FloatArray | None
) -> Calibration:
    """Return the calibration of the readings without the effects, with the effects and the uncertainty of both.

    The attitude (N, 4) is that which was recorded.
    """
    recording = model.recording
    if model.world is None:
        calibration = calibrate(_without(model, attitude), array, accept={*CHANNEL_FAULTS, *accept})
        model = replace(model, array=calibration.array, errors=calibration.errors, intensity_T=calibration.intensity_T)
    else:
        calibration = _in_world(model, array, accept)
        model = replace(model, errors=calibration.errors)
    joint = Joint(model, tuple(_free(part, model) for part in model.parts))
    sizes = joint.sizes(calibration.correction_matrix)
    kept = [pair for pair in zip(joint.effects, sizes, strict=True) if _is_kept(pair[0], model)]
    kept += [(finding.fitted, NO_SIZE) for finding in model.findings]
    effects, stays = [fitted for fitted, _ in kept], [one for one in joint.effects if not _is_kept(one, model)]
    return replace(
        calibration,
        covariance=calibration.covariance + joint.shared_covariance,
        before=measure_residuals(SensorErrors.none(recording.sensor_count), array, recording, calibration.intensity_T),
        samples=recording.sample_count,
        time_span_s=recording.time_span_s,
        warnings=tuple(dict.fromkeys((*calibration.warnings, *warnings, *_in_data(effects, stays)))),
        effects=tuple(effects),
        effect_sizes=tuple(size for _, size in kept),
    )


def _is_kept(fitted: FittedEffect, model: Model) -> bool:
    """Whether an effect can be taken off other data: of one sensor not by how its own, noisy readings go on."""
    return model.world is None or linear_effect(fitted).is_causal


def _in_data(kept: Sequence[FittedEffect], stays: Sequence[FittedEffect]) -> Iterator[str]:
    """Yield warnings of the effects that corrected data contain: those of the calibration, and others."""
    not_removable = [fitted for fitted in kept if not removable([fitted])]
    for effects, why in ((not_removable, _FOR_SIMULATIONS), (stays, _BY_ATTITUDE)):
        if effects:
            names = dict.fromkeys(fitted.effect.replace("_", " ") for fitted in effects)
            yield f"{' and '.join(names)}: {why}"


def _in_world(model: Model, array: Array, accept: Collection[str]) -> Calibration:
    """Return the calibration of one sensor as its attitude determines it, which its intensity alone may not."""
    errors = replace(model.errors, misalignment=np.zeros((1, 3)))  # the frame is the sensor's own, but for rounding
    covariance = Joint.of(model).covariance_in_world
    calibration = make_calibration(
        IN_WORLD, _without(model, model.recording.attitude), array, errors, covariance, model.intensity_T
    )
    refuse_open(calibration.standard_errors.ravel(), calibration.intensity_T)
    return within_limits(calibration, accept)


def _without(model: Model, attitude: FloatArray | None) -> Recording:
    """Return the samples of a model's recording that count, without what its effects add, with their attitude."""
    return replace(model.quiet(), attitude=attitude).take(np.flatnonzero(model.is_counted))


def _free(part: Part, model: Model) -> tuple[str, ...]:
    """Return the parameters of a shape that were fitted: those that vary among the shapes tried."""
    channels = model.channels()
    tried = list(part.effect.shapes(channels.covariates, channels.residuals))
    return tuple(name for name in part.shape if len({shape[name] for shape in tried if name in shape}) > 1)


def explained(
    sentences: Sequence[str],
    samples: SampleSource,
    array: Array,
    *,
    progress: Progress | None = None,
    accept: Collection[str] = (),
) -> tuple[str, ...]:
    """Return doubts about a calibration, or its refusal, with the cause that a diagnosis finds, its cure first.

    Parameters
    ----------
    sentences : sequence of str
        As ``is_unexplained`` finds them.
    samples : SampleSource
        That were calibrated; of more than 10 000 every n-th one is looked at, which takes some seconds.
    array, progress, accept
        As of ``diagnose``.
    """
    with suppress(InputError, Refused):
        # The user did not ask for this diagnosis: so many samples take some seconds.
        gap = diagnose(samples.thinned(10_000), array, progress=progress, accept=accept)
        asking, words = [one for one in sentences if LOOK_FOR_CAUSE in one], _in_words(gap, array.vector_noise_T)
        guesses = (SOMETHING_MAGNETIC, PARTS_APART, LEAVE_OUT) if gap.verdict == "explained" else ()
        kept = [one for one in sentences if one in asking or not (asking and any(guess in one for guess in guesses))]
        for end in (f": {guess}" for guess in (LOOK_FOR_CAUSE, *guesses)):
            kept = [one.partition(end)[0] + words if end in one else one for one in kept]
        return tuple(sorted(kept, key=lambda one: words not in one))
    return tuple(sentences)


def _in_words(gap: Gap, stated_T: FloatArray | None) -> str:
    """Return what explains a residual and what to do, as the end of the sentence on it."""
    if gap.verdict == "no_gap":
        levels_T = [one.white_T for one in gap.noise if one.sensor]
        if not levels_T or (stated_T is not None and min(levels_T) <= np.max(stated_T) <= max(levels_T)):
            return "; no noise or known effect explains it: see where and when it is, with tam diagnose --report"
        size = f"{to_nanotesla(min(levels_T)):.3g} to {to_nanotesla(max(levels_T)):.3g} nT"
        return f"; white noise of {size} explains it: state that noise in the array file"
    if not gap.named:
        return "; no known effect explains it: see where and when it is, with tam diagnose --report"
    causes = " and ".join(name.replace("_", " ") for name in gap.named)
    sensors = sorted({sensor for cause in gap.causes for sensor in cause.sensors}, key=str)
    where = f" in {sensors_in_words(sensors, gap.sensor_count)}"
    verb = f"explain{'s' if len(gap.named) == 1 else ''}{'' if gap.verdict == 'explained' else ' part of'}"
    return f"; {causes}{where} {verb} it: fit that too, with --effects {','.join(gap.named)}"
