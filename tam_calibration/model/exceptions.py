"""The two ways in which a user's request can end without a result."""


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
    A magnet that stands beside the array for half of the run leaves no one calibration that holds throughout:

    >>> from dataclasses import replace
    >>> import numpy as np
    >>> from tam_calibration import Refused, calibrate, read_scenario, simulate
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> readings_T = made.recording.readings_T.copy()
    >>> readings_T[180:] += np.array([2e-6, 0, 0])
    >>> try:
    ...     calibrate(replace(made.recording, readings_T=readings_T), made.scenario.array)
    ... except Refused:
    ...     print("refused")
    refused
    """
