"""What the judge says of one of the two recordings: diagnosis and calibration."""

from tam_calibration.comparison.result import Side
from tam_calibration.gap.calibration_with_effects import calibration_of
from tam_calibration.gap.diagnose import judge
from tam_calibration.gap.search import Progress
from tam_calibration.integrity import ACCEPTABLE
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import SampleSource


def side_of(source: SampleSource, array: Array, progress: Progress | None = None) -> Side:
    """Return what the judge says of a recording.

    Parameters
    ----------
    source : SampleSource
        Raw readings (N, K, 3), tesla.
    array : Array
        Geometry and noise.
    progress : callable, optional
        Called with the name of the stage and the part that is done, 0 to 1.

    Raises
    ------
    InputError
        When the recording cannot be used.
    Refused
        When it determines no calibration.
    """
    judgement = judge(source, array, progress=progress)
    gap, found, recording = judgement.gap, judgement.found, judgement.seen
    if found is None or gap.verdict == "not_identifiable":
        raise Refused(gap.statement)
    calibration = calibration_of(recording, found, gap, array, accept=ACCEPTABLE)
    return Side(recording, array, gap, calibration, found)
