"""A fit whose calibration is of one field, the same throughout, and accurate enough to be of use."""

from collections.abc import Callable

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.consistency import require_one_calibration, require_one_sphere
from tam_calibration.fit.identifiability import require_accurate
from tam_calibration.fit.recorded_attitude import as_if_uniform
from tam_calibration.model.array import Array
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SampleSource

Fit = Callable[[SampleSource, Array], Calibration]


def accepted(recording: SampleSource, array: Array, fit: Fit) -> Calibration:
    """Return the calibration of a fit that is of one field, the same throughout, and accurate enough to be of use.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of the array that was turned in a field.
    array : Array
        Geometry and noise of its K sensors; a noise that is not stated is estimated.
    fit : callable
        The method: from recording and array to a ``Calibration``.

    Raises
    ------
    InputError
        When the readings make no calibration, or leave parameters open.
    Refused
        When the recording is not one calibration.
    """
    try:
        calibration = fit(recording, array)
    except (InputError, Refused):
        require_one_sphere(recording)
        raise
    require_one_field(recording, calibration)
    require_accurate(calibration)
    return calibration


def require_one_field(recording: SampleSource, calibration: Calibration) -> None:
    """Check that a recording is one calibration in one field.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors.
    calibration : Calibration
        Made from them.

    Raises
    ------
    Refused
        When it is not.
    """
    uniform = as_if_uniform(recording, calibration.errors, calibration.array, calibration.ambient_gradient)
    require_one_calibration(uniform, calibration)
