"""From a recording to the source in it, at rest or alternating."""

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.localization.alternating import locate_alternating
from tam_calibration.localization.euler import DIPOLE_INDEX
from tam_calibration.localization.line_fit import DIPOLES_INDEX
from tam_calibration.localization.one_source import locate_run
from tam_calibration.localization.source_fit import SOURCES, require_index
from tam_calibration.localization.survey import WORLD_FRAME, Survey
from tam_calibration.localization.turned_samples import Regional, Samples, regional_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


def locate(
    recording: Recording, calibration: Calibration, *, index: float = DIPOLE_INDEX, frequency_hz: float | None = None
) -> Survey:
    """Locate the source in a recording.

    ``locate_steady`` and ``alternating.locate_alternating`` take more: a known regional field, a platform that
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


def locate_steady(
    recording: Recording,
    calibration: Calibration,
    *,
    index: float = DIPOLE_INDEX,
    regional_T: FloatArray | None = None,
    regional_covariance_T2: FloatArray | None = None,
    attitude_noise: float = 0.0,
) -> Survey:
    """Locate a source at rest in each sample: its position counts from the array.

    Parameters
    ----------
    recording : Recording
        With attitude.
    calibration : Calibration
        Of its array.
    index : float
        Structural index: 3 of a dipole, 2 of a line of dipoles, 1 of a line of current.
    regional_T : (3,) array, optional
        Field beside the source's in the world, tesla; fitted where it is not given.
    regional_covariance_T2 : (3, 3) array, optional
        Of that, T²; without it the field is exact.
    attitude_noise : float
        Standard deviation of the attitude about each axis, radians.

    Raises
    ------
    InputError
        When there is no attitude, or the calibration is of another array.
    Refused
        When the attitude was written otherwise than expected, no sample can be located, or the samples are not those
        of one source.
    """
    require_index(index)
    if misread := misread_attitude(recording, calibration.errors):
        raise Refused(misread)
    if recording.attitude is None:
        raise InputError(
            "the recording has no attitude, without which the regional field cannot be taken off; of an alternating "
            "source give the frequency"
        )
    if not calibration.array.has_gradient:
        raise InputError("the array's geometry determines no gradient, from which sources are located")
    if index != DIPOLE_INDEX and attitude_noise:
        raise Refused(
            f"a {SOURCES[index]} is located with an exact attitude alone: the regional field, turned by an "
            "error of it, hides what tells one line from several"
        )
    if index == DIPOLES_INDEX and regional_T is None:
        raise Refused(
            f"beside a {SOURCES[index]} the regional field cannot be found from the samples: give the "
            "place, at which it is that of IGRF"
        )
    outputs = calibration.correct(recording).outputs
    samples = Samples(outputs, calibration.array, calibration.output_covariance, recording.attitude, index)
    if regional_T is None:
        prior = regional_of(outputs, recording.attitude, attitude_noise)
    else:
        prior = Regional(regional_T, attitude_noise, regional_covariance_T2)
    world, found = locate_run(samples, prior)
    center = np.zeros((recording.sample_count, 3))
    return Survey(WORLD_FRAME, recording.time_s, world, center, regional_T=found.field_T)
