"""A steady source beside the regional field, from each sample of a recording."""

import numpy as np

from tam_calibration.correction.calibration import Calibration
from tam_calibration.fit.recorded_attitude import misread_attitude
from tam_calibration.localization.euler import DIPOLE_INDEX, require_index
from tam_calibration.localization.line_fit import DIPOLES_INDEX
from tam_calibration.localization.one_source import locate_run
from tam_calibration.localization.survey import WORLD_FRAME, Survey
from tam_calibration.localization.turned_samples import SOURCES, Regional, regional_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


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
    regional = None if regional_T is None else Regional(regional_T, attitude_noise, regional_covariance_T2)
    outputs = calibration.correct(recording).outputs
    prior = _prior(outputs, recording.attitude, index, regional, attitude_noise)
    world, found = locate_run(
        outputs, calibration.array, calibration.output_covariance, recording.attitude, prior, index
    )
    center = np.zeros((recording.sample_count, 3))
    return Survey(WORLD_FRAME, recording.time_s, world, center, regional_T=found.field_T)


def _prior(
    outputs: FloatArray, attitude: FloatArray, index: float, known: Regional | None, attitude_noise: float
) -> Regional:
    """Return what is known beforehand of the field beside the source's."""
    if index != DIPOLE_INDEX and attitude_noise:
        raise Refused(
            f"a {SOURCES[index]} is located with an exact attitude alone: the regional field, turned by an "
            "error of it, hides what tells one line from several"
        )
    if index == DIPOLES_INDEX and known is None:
        raise Refused(
            f"beside a {SOURCES[index]} the regional field cannot be found from the samples: give the "
            "place, at which it is that of IGRF"
        )
    return regional_of(outputs, attitude, attitude_noise) if known is None else known
