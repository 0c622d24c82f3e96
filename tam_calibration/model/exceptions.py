"""The two ways in which a user's request can end without a result, and how sentences name what they are about."""

import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from reprlib import Repr
from typing import Any
from unicodedata import category


class InputError(ValueError):
    """The input cannot be used; the message says what is wrong, where, and what to do.

    Examples
    --------
    >>> from tam_calibration import InputError, read_array
    >>> try:
    ...     read_array("nowhere.yaml")
    ... except InputError as problem:
    ...     print(problem)
    nowhere.yaml cannot be read: No such file or directory
    """


class Refused(RuntimeError):
    """The input is sound but the answer is no; the message gives the reason.

    Examples
    --------
    With a magnet that comes near during the last minute, no calibration is valid throughout:

    >>> from dataclasses import replace
    >>> from tam_calibration import Refused, calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> readings_T = made.recording.readings_T.copy()
    >>> readings_T[300:] += 2e-6
    >>> try:
    ...     calibrate(replace(made.recording, readings_T=readings_T), made.scenario.array)
    ... except Refused as reason:
    ...     print(str(reason).split(":")[0])
    something magnetic adds up to 3500 nT to all sensors from 300.0 s on
    """


@contextmanager
def adding(words: str) -> Iterator[None]:
    """Add words to the sentence with which a block ends without a result, where there are any.

    Raises
    ------
    InputError, Refused
        As the block.
    """
    try:
        yield
    except (InputError, Refused) as problem:
        if not words:
            raise
        raise type(problem)(f"{problem}; {words}") from problem


MOST_QUOTED = 60
"""Characters of what was read that a sentence repeats: a line of a terminal has 80, and the rest says nothing new."""

_REPR = Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = MOST_QUOTED


MOST_NAMED = 3
"""Times, faults or parameters that a sentence names: one cause, such as a dead converter, shows in the three axes of a
sensor."""


def first_at(times_s: Sequence[float]) -> str:
    """Return the first of some times, seconds, in words."""
    return f"first at {', '.join(f'{time_s:.2f}' for time_s in times_s[:MOST_NAMED])} s"


def quoted(value: Any) -> str:
    """Return what was read as a sentence quotes it: on one line, its middle left out where it is long."""
    return _REPR.repr(value)


_UNPRINTABLE = ("Cc", "Cf", "Cs", "Zl", "Zp")
"""Categories of Unicode that end a line, command a terminal, reverse the direction of text, or represent bytes."""


def printable(text: object, keep: str = "") -> str:
    r"""Return text in which unprintable characters are escaped as in JSON, such as \u001b or \udcff.

    Parameters
    ----------
    text : object
        Text, or something shown as text, such as a path or an error.
    keep : str
        Unprintable characters that stay, such as a line break.
    """
    return "".join(
        json.dumps(each)[1:-1] if category(each) in _UNPRINTABLE and each not in keep else each for each in str(text)
    )


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
