"""What the check knows of a kind of cause: what draws it, and the recording in which it can be seen."""

from dataclasses import dataclass

from tam_calibration.blind.disturbance import Draw
from tam_calibration.blind.motion import MOTIONS

MOVING = tuple(motion for motion in MOTIONS if motion != "turntable")
SWUNG = ("diver", "figure_eight")
"""Motions that swing to and fro, and not in steps."""

SEVERAL = (3, 4, 6)
"""Numbers of sensors with which a fault of one can be told from what the field does."""


@dataclass(frozen=True)
class Entry:
    """One kind of cause.

    Parameters
    ----------
    draw : callable
    family : str
        Causes of one family at one sensor are hard to tell apart; no pair is made of them.
    channel : str
        The recorded channel that decides for it; nothing when the fields suffice.
    motions : tuple of str
        Those in which it can be seen.
    sensor_counts : tuple of int
        Those with which it can be told from others.
    scalar_needed : bool
    most_nT : float
        The largest change of a reading that it makes in nature.
    most_nT_per_s : float
        The fastest change that it makes in nature, root mean square.
    large : tuple of float
        The large gaps, in noise floors, that it can have in nature.
    named : str
        For a cause outside the library: the name of an effect that is as right an answer as none.
    coarse : bool
        Whether a small gap of it takes a noisy sensor, as one sample in a quiet one is a large gap already.
    sealed : bool
        Whether nobody who writes rules of the diagnosis may know of it.
    """

    draw: Draw
    family: str
    channel: str = ""
    motions: tuple[str, ...] = MOTIONS
    sensor_counts: tuple[int, ...] = (2, 3, 4, 6)
    scalar_needed: bool = False
    most_nT: float = 10_000.0
    most_nT_per_s: float = float("inf")
    large: tuple[float, ...] = (30.0, 1000.0)
    named: str = ""
    coarse: bool = False
    sealed: bool = False


def outside(
    draw: Draw, named: str = "", motions: tuple[str, ...] = MOTIONS, scalar_needed: bool = False, sealed: bool = False
) -> Entry:
    """Return the entry of a cause outside the library, in one of several sensors or the scalar."""
    return Entry(
        draw,
        "outside",
        motions=motions,
        sensor_counts=SEVERAL,
        scalar_needed=scalar_needed,
        named=named,
        sealed=sealed,
    )


def sealed(draw: Draw, named: str = "", motions: tuple[str, ...] = MOTIONS, scalar_needed: bool = False) -> Entry:
    """Return the entry of a cause of the sealed half."""
    return outside(draw, named=named, motions=motions, scalar_needed=scalar_needed, sealed=True)
