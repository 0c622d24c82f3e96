"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks.

Of a long recording it looks at stretches, so that time and memory have a bound. Within a stretch nothing is left out,
so that what goes on from sample to sample stays: delays, ringing, spikes, the spectrum. One stretch lies in each equal
part of the run, so that what is slow stays too; where in its part it lies is uneven, so that nothing that comes again
and again hides between them.
"""

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
from numpy.linalg import LinAlgError

from tam_calibration.effects.grades import LEAST_SAMPLES, NEGLIGIBLE
from tam_calibration.effects.library import installed_effects, shown_by
from tam_calibration.fit.consistency import accepted, residual_that_changes
from tam_calibration.fit.identifiability import require_determined
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.fit.reference import turning_scalar
from tam_calibration.fit.screening import sound_readings
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.field_direction import field_direction
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.noise import recorded_noise, remarks_on
from tam_calibration.gap.nominal import ENOUGH_SAMPLES, canonical_correlations, open_parameters, significant_correlation
from tam_calibration.gap.result import Considered, Gap, Residue, Size, Where
from tam_calibration.gap.search import Progress, search
from tam_calibration.gap.steps import Search
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import FieldBounds
from tam_calibration.model.libraries import load_within_limit
from tam_calibration.model.recording import Recording, SampleSource


def diagnose(
    recording: SampleSource,
    array: Array,
    *,
    without: Collection[str] = (),
    progress: Progress | None = None,
    accept: Collection[str] = (),
) -> Gap:
    """Say where a recording departs from its simulation, which effect causes it, and how far the gap then shrinks.

    Parameters
    ----------
    recording : Recording or SampleSource
        Raw readings (N, K, 3) of one run, tesla; every channel that it has helps. Of more than 50 000 samples it looks
        at so many, in stretches that are spread over the run.
    array : Array
        Geometry, noise, and what the intensity of the field can be; a noise that is not stated is estimated.
    without : collection of str
        Names of effects that are not named as causes.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.
    accept : collection of str
        Names of findings on the channels that shall refuse nothing: ``tam_calibration.integrity.ACCEPTABLE``.

    Returns
    -------
    Gap
        The verdict with its evidence; sizes in tesla, T/m and noise floors.

    Raises
    ------
    InputError
        When the recording cannot be used or does not belong to the array.
    Refused
        When its channels are not those of sound sensors, by more than effects of the library.

    Examples
    --------
    >>> from tam_calibration import diagnose, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> gap = diagnose(made.recording, made.scenario.array)
    >>> gap.verdict, gap.causes
    ('no_gap', ())
    """
    return judge(recording, array, without=without, progress=progress, accept=accept).gap


@dataclass(frozen=True, eq=False)
class Judgement:
    """A diagnosis, with the search that it rests on.

    Parameters
    ----------
    gap : Gap
        The diagnosis.
    seen : Recording
        The samples that it looked at.
    found : Search, optional
        Models without and with the causes; None where the recording determines no calibration.
    """

    gap: Gap
    seen: Recording
    found: Search | None


def judge(
    recording: SampleSource,
    array: Array,
    *,
    without: Collection[str] = (),
    progress: Progress | None = None,
    accept: Collection[str] = (),
) -> Judgement:
    """Return the diagnosis of a recording with the models that it rests on.

    Parameters
    ----------
    recording : Recording or SampleSource
        As of ``diagnose``.
    array : Array
        The same.
    without : collection of str
        Names of effects that are not named as causes.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.
    accept : collection of str
        Names of findings on the channels that shall refuse nothing.

    Raises
    ------
    InputError, Refused
        As ``diagnose``.
    """
    load_within_limit(_LIBRARIES, _LEAST_BYTES)
    array.require_recording(recording)
    used, left_out, faults = sound_readings(recording, array, accept, shown_by(installed_effects()))
    seen, of_stretches = in_stretches(recording)
    seen.check_plausible(array.field)
    gap, found = _judged(seen, array, without, progress)
    grave = [fault.sentence for fault in faults if fault.severity == "refusal"]
    refusal, doubt = ("", "") if grave else objections_to(used, array)
    alone = " without the tolerances of the array file" if array.tolerances is not None and not grave else ""
    remarks = list(of_stretches)
    remarks += [f"tam calibrate would refuse this recording{alone}: {each}." for each in grave or [refusal] if each]
    if doubt and gap.verdict != "explained":
        remarks.append(f"tam calibrate would doubt this recording: {doubt}.")
    if left_out is not None and not left_out.is_lasting:
        remarks += [f"tam calibrate leaves out single readings: {each}." for each in left_out.sentences()]
    remarks += [f"The channels: {fault.sentence}." for fault in faults if fault.severity != "refusal"]
    if misread := misread_attitude(seen):
        remarks.append(f"{misread[:1].upper()}{misread[1:]}.")
    return Judgement(replace(gap, remarks=(*remarks, *gap.remarks)), seen, found)


def _judged(
    recording: Recording, array: Array, without: Collection[str], progress: Progress | None
) -> tuple[Gap, Search | None]:
    if recording.sample_count < needed_samples(recording.sensor_count):
        return too_short(recording), None
    if is_at_rest(recording, array.field):
        reason = (
            "the array was hardly turned, or its sensors share no motion: calibration and effects cannot be told apart"
        )
        return _no_verdict(recording, reason, "the array was not turned"), None
    # One sensor without attitude has no channel but the intensity, which undetermined parameters absorb.
    alone = recording.sensor_count == 1 and recording.attitude is None
    if alone and (left_open := open_parameters(recording, array)) is not None:
        return _no_verdict(recording, left_open), None
    try:
        found = search(recording, array, without, progress)
        gap = conclude(found)
    except Refused as problem:
        return _no_verdict(recording, str(problem)), None
    except LinAlgError:
        return _no_verdict(recording, "its equations have no solution"), None
    model = found.nominal if gap.verdict == "no_gap" else found.model
    noise = recorded_noise(model, array)
    is_determined = floor_of(found.nominal.channels(), array).is_determined and bool(noise)
    remarks = remarks_on(noise, array, is_determined, int(model.is_counted.sum()))
    remarks += field_direction(model, recording, array)
    return replace(gap, noise=noise, remarks=remarks), found


_LIBRARIES = ("scipy.interpolate", "scipy.fft")
"""With all that they load in turn, those that a diagnosis uses."""

_LEAST_BYTES = 224 << 20
"""Memory that a diagnosis of 4000 samples needs: 205 MiB, measured with `ulimit -v`."""

MOST_SAMPLES = 50_000
"""Samples that a diagnosis looks at, at most: eight minutes at 100 Hz. See ``benchmarks/diagnose_scale.py``."""

STRETCH = 500
"""Samples of a stretch: many times the memory of filters and loops, and a hundredth of all that are looked at."""


def in_stretches(source: SampleSource) -> tuple[Recording, tuple[str, ...]]:
    """Return what a diagnosis looks at of a recording, and what is to be said about that.

    Parameters
    ----------
    source : SampleSource
        N samples, which need not fit into memory.

    Returns
    -------
    recording : Recording
        All samples, or where there are more than ``MOST_SAMPLES`` so many, in stretches of ``STRETCH``.
    remarks : tuple of str
        One sentence where samples are left out.
    """
    count, parts = source.sample_count, MOST_SAMPLES // STRETCH
    if count <= MOST_SAMPLES:
        return source.whole(), ()
    part = np.arange(parts)
    free = count / parts - STRETCH
    # At random: any regular rule has periods at which all stretches would begin in the same phase.
    starts = (part * count / parts + free * np.random.default_rng(0).random(parts)).astype(int)
    chosen = np.zeros(count, dtype=bool)
    chosen[starts[:, None] + np.arange(STRETCH)] = True
    recording = source.take(chosen).whole()
    longest_s = float(np.diff(recording.time_s).max())
    remark = (
        f"Of {count} samples the diagnosis looks at {recording.sample_count}, in {parts} stretches that are spread "
        f"over the run: what happens between them only, in up to {longest_s:.3g} s, is not seen."
    )
    return recording, (remark,)


def objections_to(recording: SampleSource, array: Array) -> tuple[str, str]:
    """Return why a calibration of the recording would be refused, and when something came near; empty otherwise.

    Parameters
    ----------
    recording : SampleSource
        Without single bad readings; a long one is thinned.
    array : Array
        Of the recording; a noise that is not stated is estimated.
    """
    some = recording.thinned(ENOUGH_SAMPLES)
    try:
        if (scalar := turning_scalar(some, array)) is not None and scalar.is_most:
            return "", scalar.sentence
        require_determined(some, array)
        return "", residual_that_changes(some, accepted(some, array, maximum_likelihood))
    except (InputError, Refused) as problem:
        return str(problem), ""
    except LinAlgError:
        return "the readings do not fit one calibration", ""


def needed_samples(sensor_count: int) -> int:
    """Return how many samples any verdict takes."""
    # A verdict takes sixty degrees of freedom beyond the calibration.
    channels = 60 + 12 * sensor_count - 3
    return max(LEAST_SAMPLES, -(-channels // (3 * sensor_count - 2)))


def is_at_rest(recording: Recording, field: FieldBounds) -> bool:
    """Whether the first sensor hardly moves, or moves on a line, or no other's readings are correlated with it.

    Parameters
    ----------
    recording : Recording
        Of K sensors.
    field : FieldBounds
        Bounds of the intensity: readings whose spread is small against the lower one are at rest.
    """
    first = recording.readings_T[:, 0] - recording.readings_T[:, 0].mean(axis=0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(first.T @ first / len(first)), 0))
    # As much as a turn of half a degree.
    if spread[1] < NEGLIGIBLE * field.low_T:
        return True
    shared = canonical_correlations(recording.readings_T)[1:, 1]
    return bool((shared < significant_correlation(recording.sample_count)).all()) if len(shared) else False


def too_short(recording: Recording) -> Gap:
    """Return the answer without a verdict for a recording with too few samples."""
    count = recording.sensor_count
    needed, some = needed_samples(count), recording.sample_count
    why = f"{some} sample{'s' * (some > 1)} of {count} sensor{'s' * (count > 1)}"
    return _no_verdict(recording, f"it takes {needed} samples at least, not {why}", "the recording is too short")


def _no_verdict(recording: Recording, reason: str, why: str = "there is no calibration to start from") -> Gap:
    """Return the answer without a verdict, with a reason in one clause for the recording, and one for each effect."""
    first, last = recording.time_span_s
    row_count, nan = 3 * recording.sensor_count + 1, float("nan")
    nothing = np.full((recording.sample_count, row_count), np.nan)
    return Gap(
        "not_identifiable",
        Size(nan, nan, nan, nan, nan, nan, nan, nan, (nan, nan)),
        Where(),
        (),
        tuple(Considered(name, "not_identifiable", why) for name in installed_effects()),
        {},
        f"Record {2 * needed_samples(recording.sensor_count)} samples or more while turning the array through all "
        "attitudes.",
        f"No verdict on the recording of {last - first:.1f} s: {reason}.",
        Residue(recording.time_s, nothing[:, :3], nothing, nothing, nothing, np.full(row_count, np.nan)),
    )
