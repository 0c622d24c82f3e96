"""One law of a gap, as the answer states it."""

from collections.abc import Sequence
from dataclasses import dataclass

from tam_calibration.model.sensors_in_words import sensors_in_words
from tam_calibration.model.units import FloatArray

Place = tuple[int | str, ...]
"""Numbers of sensors from 1, "scalar", or "attitude"."""

SCALAR: Place = ("scalar",)
ATTITUDE: Place = ("attitude",)

FREE: frozenset[str] = frozenset({"step", "episodes", "slow", "random"})
"""Courses of any function of time."""

CHANCE: frozenset[str] = frozenset({"noise", "samples"})
"""Laws of which no sample tells another."""


@dataclass(frozen=True, eq=False)
class Course:
    """How the size of a law goes with time.

    Parameters
    ----------
    time_s : (B,) array
        Time stamps, seconds.
    size, error : (B,) array
        Size along the direction in which the readings are shifted most, with its standard error.
    unit : str
        Of the size: "T", or "1" for a part of the field.
    """

    time_s: FloatArray
    size: FloatArray
    error: FloatArray
    unit: str


@dataclass(frozen=True, eq=False)
class Signature:
    """One law of a gap.

    Parameters
    ----------
    law, course : str
        What the disturbance does to a reading, and how its size goes with time.
    sensors, axes : tuple
        Where.
    energy : float
        Share of the gap that it explains out of sample.
    places : tuple of tuple
        Every set of sensors in which it may sit as far as the data tell, the likeliest first.
    follows : str, optional
        A recorded channel, "motion", "attitude", a frequency; None where nothing that was recorded goes with it.
    times_s : tuple of float
        Times of steps, or begin and end of each episode.
    evidence : float
        Log odds against no law.
    curve : Course, optional
        The course with its error.
    """

    law: str
    course: str
    sensors: Place
    axes: tuple[str, ...]
    energy: float
    places: tuple[Place, ...]
    follows: str | None
    times_s: tuple[float, ...]
    evidence: float
    curve: Course | None = None

    @property
    def is_common(self) -> bool:
        """Whether the residual of the intensity alone shows it: an error of the scalar, or a field at all sensors."""
        return not self.axes


def in_words(places: Sequence[Place], sensor_count: int, is_common: bool) -> str:
    """Return places in words, joined by "or".

    Parameters
    ----------
    places : sequence of Place
    sensor_count : int
        Number of sensors K.
    is_common : bool
        Whether all sensors feel it alike.
    """
    found = {_one_in_words(place, sensor_count, is_common): place for place in places}
    return ", or ".join(sorted(found, key=lambda words: found[words] != SCALAR) if is_common else found)


def _one_in_words(place: Place, sensor_count: int, is_common: bool) -> str:
    if place in (SCALAR, ATTITUDE):
        return f"the {place[0]}"
    if is_common:
        return "the field at all sensors alike"
    return sensors_in_words([int(one) for one in place], sensor_count)
