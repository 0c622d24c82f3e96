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

from tam_calibration.effects.library import installed_effects, shown_by
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.floor import floor_of
from tam_calibration.gap.recorded_noise import recorded_noise, remarks_on
from tam_calibration.gap.refusal import (
    at_rest,
    is_at_rest,
    needed_samples,
    open_parameters,
    refusal_of,
    too_short,
    without_nominal,
)
from tam_calibration.gap.result import Gap
from tam_calibration.gap.search import Progress, search
from tam_calibration.gap.search_result import Search
from tam_calibration.integrity import require_sound
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.memory import load_within_limit
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
        Raw readings (N, K, 3) of one run, tesla; every channel that it has helps. Of more than 100 000 samples it looks
        at so many, in stretches that are spread over the run.
    array : Array
        Geometry, noise, and what the intensity of the field can be; a noise that is not stated is estimated.
    without : collection of str
        Names of effects that are not tried.
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
        Names of effects that are not tried.
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
    faults = require_sound(recording, array, accept, sought=shown_by(installed_effects()))
    seen, of_stretches = in_stretches(recording)
    seen.check_plausible(array.field)
    grave = [fault.sentence for fault in faults if fault.severity == "refusal"]
    refusals = grave or [refusal for refusal in [refusal_of(seen, array)] if refusal is not None]
    alone = " without the tolerances of the array file" if array.tolerances is not None and not grave else ""
    remarks = [
        *of_stretches,
        *(f"tam calibrate would refuse this recording{alone}: {refusal}." for refusal in refusals),
    ]
    remarks += [f"The channels: {fault.sentence}." for fault in faults if fault.severity != "refusal"]
    if misread := misread_attitude(seen):
        remarks.append(f"{misread[:1].upper()}{misread[1:]}.")
    gap, found = _judged(seen, array, without, progress)
    return Judgement(replace(gap, remarks=(*remarks, *gap.remarks)), seen, found)


def _judged(
    recording: Recording, array: Array, without: Collection[str], progress: Progress | None
) -> tuple[Gap, Search | None]:
    if recording.sample_count < needed_samples(recording.sensor_count):
        return too_short(recording), None
    if is_at_rest(recording, array.field):
        return at_rest(recording), None
    # One sensor without attitude has no channel but the intensity, which undetermined parameters absorb.
    alone = recording.sensor_count == 1 and recording.attitude is None
    if alone and (left_open := open_parameters(recording, array)) is not None:
        return without_nominal(recording, left_open), None
    try:
        found = search(recording, array, without, progress)
        gap = conclude(found)
    except Refused as problem:
        return without_nominal(recording, str(problem)), None
    except LinAlgError:
        return without_nominal(recording, "its equations have no solution"), None
    model = found.nominal if gap.verdict == "no_gap" else found.model
    noise = recorded_noise(model, array)
    is_determined = floor_of(found.nominal.channels(), array).is_determined and bool(noise)
    remarks = remarks_on(noise, array, is_determined, int(model.is_counted.sum()))
    return replace(gap, noise=noise, remarks=remarks), found


_LIBRARIES = ("scipy.interpolate", "scipy.fft")
"""With all that they load in turn, those that a diagnosis uses."""

_LEAST_BYTES = 224 << 20
"""Memory that a diagnosis of 4000 samples needs: 205 MiB, measured with `ulimit -v`."""

MOST_SAMPLES = 100_000
"""Samples that a diagnosis looks at, at most: a quarter of an hour at 100 Hz, in less than 500 MiB."""

STRETCH = 1000
"""Samples of a stretch: many times the memory of filters and loops, and a hundredth of all that are looked at."""

_GOLDEN_SECTION = (np.sqrt(5) - 1) / 2
"""Its multiples are, without their whole part, spread evenly over 0 to 1 however many there are (Weyl)."""


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
    starts = (part * count / parts + free * (part * _GOLDEN_SECTION % 1)).astype(int)
    chosen = np.zeros(count, dtype=bool)
    chosen[starts[:, None] + np.arange(STRETCH)] = True
    recording = source.take(chosen).whole()
    longest_s = float(np.diff(recording.time_s).max())
    remark = (
        f"Of {count} samples the diagnosis looks at {recording.sample_count}, in {parts} stretches that are spread "
        f"over the run: what happens between them only, in up to {longest_s:.3g} s, is not seen."
    )
    return recording, (remark,)
