"""Gross mistakes of simulators: units, frames, the world's field and noise, found before anything is fitted."""

from tam_calibration.comparison.mistakes.frames import (
    frames_of,
    ignored_field,
    mistaken_attitude,
    mistaken_axes,
    mistaken_field,
    turned_against_others,
    unturned,
    without_field,
)
from tam_calibration.comparison.mistakes.noise import mistaken_noise
from tam_calibration.comparison.mistakes.units import mistaken_stamps, mistaken_units
from tam_calibration.comparison.result import Mistake
from tam_calibration.integrity.fault import Overview
from tam_calibration.integrity.placement import Motion, placements
from tam_calibration.model.array import Array
from tam_calibration.model.recording import Recording


def mistakes_of(
    simulation: Recording, recording: Recording, array_of_simulation: Array, array: Array
) -> tuple[Mistake, ...]:
    """Return the gross mistakes of the simulator that made a recording; the real one is taken as right.

    Frames and the world's field are compared where both have attitude. A mistake of units is put right before the
    others are sought.

    Parameters
    ----------
    simulation, recording : Recording
        The two, as they were read, along the axes of the array; paths, lengths, rates and sites may differ.
    array_of_simulation, array : Array
        Theirs.

    Returns
    -------
    tuple of Mistake
        Units, stamps, the world's field, frames, noise; empty for a simulation that has none.
    """
    units, simulation = mistaken_units(simulation, recording, array_of_simulation)
    return (
        *units,
        *mistaken_stamps(simulation, recording),
        *_of_field_and_frames(simulation, recording),
        *mistaken_noise(simulation, recording, array),
    )


def _of_field_and_frames(simulation: Recording, recording: Recording) -> list[Mistake]:
    count, silent = simulation.sensor_count, without_field(simulation, recording)
    if len(silent) == count:
        return list(ignored_field(silent, [], count))
    own, other = Overview.of(simulation), Overview.of(recording)
    other_motion = Motion.of(other.recording.attitude)
    right = [] if other_motion is None else placements(other, other_motion)
    attitude, motion, placed = mistaken_attitude(own, right)
    stuck = [] if motion is None else [each for each in unturned(own, motion, placed) if each not in silent]
    mistakes = [*ignored_field(silent, stuck, count), *attitude]
    frames = frames_of(placed, right)
    if frames is None or motion is None or other_motion is None:
        return [*mistakes, *turned_against_others(own, other)]
    world = mistaken_field(frames, motion, other_motion)
    return [*mistakes, *mistaken_axes(frames), *([] if world is None else [world])]
