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
