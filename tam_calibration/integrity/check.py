"""The check of the channels of a recording before any fit, in one pass and from some of its samples."""

from collections.abc import Collection, Iterable, Iterator

import numpy as np

from tam_calibration.core.alternation import alternations
from tam_calibration.integrity.fault import Fault, Overview, refuse, require_names
from tam_calibration.integrity.placement import left_handed
from tam_calibration.integrity.repeated import Copies, FrozenAxes
from tam_calibration.integrity.values import at_ends, in_other_units, in_steps, with_stuck_bits
from tam_calibration.model.array import Array
from tam_calibration.model.recording import FEWEST_SAMPLES, Recording, SampleSource
from tam_calibration.model.units import to_nanotesla

_SCREENED = ("frozen", "unit", "zero")
"""Faults that single readings can have."""


def faults_of(source: SampleSource, array: Array) -> list[Fault]:
    """Return the faults of a recording's channels.

    A fault that causes others is reported alone: a sensor in another unit, for example, looks faulty in other ways too.

    Parameters
    ----------
    source : SampleSource
        Raw readings of K sensors, and the scalar where there is one.
    array : Array
        Noise of these sensors where it is stated, and what the intensity of the field can be.
    """
    if source.sample_count < 2 * FEWEST_SAMPLES:
        return []
    overview, faults = Overview.of(source), list[Fault]()
    with np.errstate(all="ignore"):  # readings may be any finite numbers
        for found in _each_kind(source, overview, array):
            taken = {(fault.sensor, fault.axis) for fault in faults if fault.severity == "refusal"}
            faults += [one for one in found if taken.isdisjoint({(one.sensor, ""), (one.sensor, one.axis)})]
    return faults + _constant(overview.recording)


def _each_kind(source: SampleSource, overview: Overview, array: Array) -> Iterator[Iterable[Fault]]:
    """Yield the faults of each kind; those that cause others first."""
    frozen, copies = FrozenAxes(source.sensor_count), Copies()
    for block in source.blocks():
        frozen.add(block)
        copies.add(block)
    yield frozen.faults(source)
    yield copies.faults(overview)
    yield in_other_units(overview, array)
    yield at_ends(overview)
    yield with_stuck_bits(overview)
    yield in_steps(overview, array)
    alternating, time_s = alternations(next(iter(source.blocks())).readings_T), overview.time_s
    yield (Fault("alternating", one, "", time_s, words, may_be_effect=True) for one, words in alternating.items())
    yield left_handed(overview)


def _constant(some: Recording) -> list[Fault]:
    """Return a note on each channel but the sensors whose readings never change."""
    channels = {"temperature": (some.temperature_C, "°C"), "current": (some.current_A, "A")}
    if some.scalar_T is not None:
        channels["scalar"] = to_nanotesla(some.scalar_T[np.isfinite(some.scalar_T)]), "nT"
    notes = []
    for name, (values, unit) in channels.items():
        if values is not None and len(values) >= FEWEST_SAMPLES and np.ptp(values) == 0:
            sentence = f"the {name} is {values[0]:g} {unit} in every sample: make sure that it is recorded at all"
            notes.append(Fault("frozen", None, "", (some.time_s[0], some.time_s[-1]), sentence, "note"))
    return notes


def require_sound(
    source: SampleSource,
    array: Array,
    accept: Collection[str] = (),
    *,
    sought: Collection[str] = (),
    screened: SampleSource | None = None,
) -> list[Fault]:
    """Refuse a recording whose channels are not those of sound sensors, and return what is to be known of it.

    Parameters
    ----------
    source : SampleSource
        Raw readings of K sensors, and the scalar where there is one.
    array : Array
        Noise of these sensors where it is stated, and what the intensity of the field can be.
    accept : collection of str
        Names of faults that refuse nothing.
    sought : collection of str
        Names of faults that effects explain which will be fitted too: those refuse nothing.
    screened : SampleSource, optional
        The samples without single bad readings: short constant stretches and zeros are sought in these.

    Returns
    -------
    list of Fault
        Those that refuse nothing.

    Raises
    ------
    InputError
        When a name to accept is not known.
    Refused
        It names sensors, axes and times.
    """
    require_names(accept)
    faults = faults_of(source, array)
    if screened is not None and any(fault.name in _SCREENED for fault in faults):
        left = [fault for fault in faults_of(screened, array) if fault.name in _SCREENED]
        faults = left + [fault for fault in faults if fault.name not in _SCREENED]
    refusals = [fault for fault in faults if fault.severity == "refusal" and fault.name not in accept]
    refuse(fault for fault in refusals if not (fault.may_be_effect and fault.name in sought))
    return faults


def require_enough(sample_count: int, accept: Collection[str] = ()) -> None:
    """Refuse a recording of which too few samples are left to check a fit on.

    Parameters
    ----------
    sample_count : int
        Number of samples.
    accept : collection of str
        Names of faults that refuse nothing.

    Raises
    ------
    Refused
        When there are too few.
    """
    if sample_count < 2 * FEWEST_SAMPLES and "few_samples" not in accept:
        sentence = (
            f"{sample_count} samples leave too few to check a fit on: record {2 * FEWEST_SAMPLES} or more, better 50"
        )
        refuse([Fault("few_samples", None, "", (0.0, 0.0), sentence)])
