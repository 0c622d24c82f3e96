"""Sensors, by their numbers from 1, for people."""

from collections.abc import Iterable, Sequence


def numbered(sensors: Iterable[int]) -> str:
    """Return the numbers of sensors: "sensor 2", or "sensors 1, 2 and 4"."""
    *some, last = map(str, sensors)
    return f"sensors {', '.join(some)} and {last}" if some else f"sensor {last}"


def sensors_in_words(sensors: Sequence[int | str], count: int = 0, axes: Sequence[str] = ()) -> str:
    """Return a place in words: "sensor 2, axis x", "all sensors and the scalar"; "nowhere" where it is empty.

    Parameters
    ----------
    sensors : sequence of int or str
        Numbers from 1, and words such as "scalar".
    count : int
        Number of sensors of the array: all of them are not named one by one.
    axes : sequence of str
        "x", "y", "z"; named where they are not all three.
    """
    numbers = [one for one in sensors if isinstance(one, int)]
    others = [f"the {one}" for one in sensors if isinstance(one, str)]
    named = "all sensors" if len(numbers) == count > 1 else numbered(numbers) if numbers else ""
    if numbers and 0 < len(axes) < 3:
        named += f", ax{'e' if len(axes) > 1 else 'i'}s {' and '.join(axes)}"
    return " and ".join(filter(None, [named, *others])) or "nowhere"
