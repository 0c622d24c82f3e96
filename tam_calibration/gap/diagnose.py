"""The diagnosis of a recording: is there a gap, where, which effect causes it, and how far it shrinks."""

from collections.abc import Collection

from tam_calibration.array import Array
from tam_calibration.gap.conclude import conclude
from tam_calibration.gap.looking import Progress
from tam_calibration.gap.result import Gap
from tam_calibration.gap.short import at_rest, is_at_rest, needed_samples, too_short
from tam_calibration.gap.steps import search
from tam_calibration.problems import InputError
from tam_calibration.recording import Recording


def diagnose(
    recording: Recording, array: Array, *, without: Collection[str] = (), progress: Progress | None = None
) -> Gap:
    """Say where a recording departs from its simulation, which effect causes it, and how far the gap then shrinks.

    Parameters
    ----------
    recording : Recording
        Of one run; every channel that it has helps.
    array : Array
        Geometry and noise; a noise that is not stated is estimated.
    without : collection of str
        Names of effects that are not tried.
    progress : callable, optional
        Is told the stage and the part that is done, 0 to 1.

    Returns
    -------
    Gap
        The verdict with its evidence.

    Raises
    ------
    InputError
        When the recording cannot be used or does not belong to the array.
    Refused
        When no calibration fits any part of it.
    """
    if recording.sensor_count != array.sensor_count:
        raise InputError(
            f"the recording has {recording.sensor_count} sensors, the array {array.sensor_count}: "
            "use the array file of this recording"
        )
    recording.check_plausible()
    if recording.sample_count < needed_samples(recording.sensor_count):
        return too_short(recording)
    if is_at_rest(recording):
        return at_rest(recording)
    return conclude(search(recording, array, without, progress))
