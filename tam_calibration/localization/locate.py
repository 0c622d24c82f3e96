"""One call from a recording to the source in it, at rest or alternating."""

from tam_calibration.correction.calibration import Calibration
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.steady import locate_steady
from tam_calibration.localization.survey import Survey
from tam_calibration.model.recording import Recording


def locate(
    recording: Recording, calibration: Calibration, *, index: float = DIPOLE_INDEX, frequency_hz: float | None = None
) -> Survey:
    """Locate the source in a recording.

    ``survey.locate_steady`` and ``survey.locate_alternating`` take more: a known regional field, a platform that goes
    straight, a frequency that is to be found.

    Parameters
    ----------
    recording : Recording
        Raw readings, with the attitude (x, y, z, w, from the array frame to the world) where the source is at rest.
    calibration : Calibration
        Of its array.
    index : float
        Structural index of Euler's equation: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    frequency_hz : float, optional
        Of an alternating source; without it the source is at rest.

    Returns
    -------
    Survey
        Position in metres and moment in A m² of each sample or pose, with covariances; axes of the world, positions
        counted from the array.

    Raises
    ------
    InputError
        When the calibration is of another array, or the recording lacks what is needed.
    Refused
        When nothing can be located.
    """
    if frequency_hz is None:
        return locate_steady(recording, calibration, index=index)
    return locate_alternating(recording, calibration, frequency_hz, index=index)
