"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Collection
from dataclasses import dataclass, replace

from numpy.linalg import LinAlgError

from tam_calibration.effects.library import installed_effects, shown_by
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.floor import floor_of
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
from tam_calibration.gap.search import Progress, Search, search
from tam_calibration.gap.stretches import in_stretches
from tam_calibration.integrity import require_sound
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
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
    if recording.sensor_count != array.sensor_count:
        raise InputError(
            f"the recording has {recording.sensor_count} sensors, the array {array.sensor_count}: "
            "use the array file of this recording"
        )
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
    remarks += [f"The channels: {fault.sentence}." for fault in faults if fault.severity == "warning"]
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
    floor = floor_of(found.nominal.channels(), array)
    return replace(gap, floor=floor, remarks=floor.remarks), found
