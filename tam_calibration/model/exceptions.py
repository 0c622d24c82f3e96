"""The two ways in which a user's request can end without a result, and how their sentences quote what was read."""

from reprlib import Repr
from typing import Any


class InputError(ValueError):
    """The input cannot be used; the message says what is wrong, where, and what would mend it.

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
    A magnet that comes near during the last minute leaves no calibration that holds throughout:

    >>> from dataclasses import replace
    >>> from tam_calibration import Refused, calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> readings_T = made.recording.readings_T.copy()
    >>> readings_T[300:] += 2e-6
    >>> try:
    ...     calibrate(replace(made.recording, readings_T=readings_T), made.scenario.array)
    ... except Refused as reason:
    ...     print(str(reason).split(":")[0])
    the recording is not one calibration
    """


MOST_QUOTED = 60
"""Characters of what was read that a sentence repeats: a line of a terminal has 80, and the rest says nothing new."""

_REPR = Repr()
_REPR.maxstring = _REPR.maxother = _REPR.maxlong = MOST_QUOTED


def quoted(value: Any) -> str:
    """Return what was read as a sentence quotes it: on one line, its middle left out where it is long."""
    return _REPR.repr(value)
