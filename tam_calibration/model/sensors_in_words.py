"""Sensors, by their numbers from 1, for people."""

from collections.abc import Iterable, Sequence


def numbered(sensors: Iterable[int]) -> str:
    """Return the numbers of sensors: "sensor 2", or "sensors 1, 2 and 4"."""
    *some, last = map(str, sensors)
    return f"sensors {', '.join(some)} and {last}" if some else f"sensor {last}"


def sensors_in_words(sensors: Sequence[int], count: int) -> str:
    """Return the numbers of some of so many sensors, or that they are all."""
    return "all sensors" if len(sensors) == count > 1 else numbered(sensors)
