"""Gross mistakes of simulators: units, frames, the world's field and noise, found before anything is fitted."""

from tam_calibration.comparison.mistakes.frames import mistaken_frames
from tam_calibration.comparison.mistakes.noise import mistaken_noise
from tam_calibration.comparison.mistakes.units import mistaken_stamps, mistaken_units
from tam_calibration.comparison.result import Mistake
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
        *mistaken_frames(simulation, recording),
        *mistaken_noise(simulation, recording, array),
    )
