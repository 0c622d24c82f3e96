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

    ``steady.locate_steady`` and ``alternating.locate_alternating`` take more: a known regional field, a platform that
    goes straight, a frequency that is to be found.

    Parameters
    ----------
    recording : Recording
        Raw readings (N, K, 3), tesla, with the attitude (x, y, z, w, from the array frame to the world) where the
        source is at rest.
    calibration : Calibration
        Of its array.
    index : float
        Structural index of Euler's equation: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    frequency_hz : float, optional
        Of an alternating source, hertz; without it the source is at rest.

    Returns
    -------
    Survey
        Position in metres and moment in A m² of each sample or pose, with covariances, counted from the array; axes of
        the world, or of the array where there is no attitude.

    Raises
    ------
    InputError
        When the calibration is of another array, or the recording lacks what is needed.
    Refused
        When nothing can be located.

    Examples
    --------
    A dipole 3.7 m away that alternates at 10 Hz, beside the Earth's field:

    >>> import numpy as np
    >>> from tam_calibration import Recording, calibrate, locate, read_scenario, simulate
    >>> from tam_calibration.sources.dipole import Dipole
    >>> made = simulate(read_scenario("wu_table_1"))
    >>> calibration = calibrate(made.recording, made.scenario.array)
    >>> source = Dipole(np.array([3.0, 1.0, -2.0]), np.array([20.0, 0.0, 500.0]))
    >>> time_s = np.arange(1000) / 100
    >>> swing = np.cos(2 * np.pi * 10 * time_s)[:, None, None]
    >>> field_T = np.array([0.0, 20e-6, -45e-6]) + swing * source.field_T(made.scenario.array.positions_m)
    >>> survey = locate(Recording(time_s, calibration.errors.distort(field_T)), calibration, frequency_hz=10.0)
    >>> survey.solutions.position_m.round(1) + 0.0
    array([[ 3.,  1., -2.]])
    """
    if frequency_hz is None:
        return locate_steady(recording, calibration, index=index)
    return locate_alternating(recording, calibration, frequency_hz, index=index)
