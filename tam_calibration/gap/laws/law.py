"""One law of a gap, as the answer states it."""

from dataclasses import dataclass

from tam_calibration.model.units import FloatArray

Place = tuple[int | str, ...]
"""Numbers of sensors from 1, or "scalar"."""


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
