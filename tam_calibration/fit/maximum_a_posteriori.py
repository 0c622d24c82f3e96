"""The calibration of a recording and of what else is known: a prior, attitude, a main field."""

from dataclasses import replace

import numpy as np

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.acceptance import LARGEST_ANGLE_ERROR
from tam_calibration.correction.calibration import FRAME_STATEMENT as FIRST_SENSOR
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Moved, Update
from tam_calibration.fit.contradiction import probability_of
from tam_calibration.fit.estimate import Estimate, make_calibration, measure_chi_square
from tam_calibration.fit.prior import Prior, turned
from tam_calibration.fit.problem import Known, Posterior, posterior_of
from tam_calibration.fit.recorded_attitude import FRAME_STATEMENT
from tam_calibration.fit.slow_residuals import with_variance_factors
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

NAME = "maximum_a_posteriori"

FRAME_OF_GYROSCOPE = (
    "The array frame is that of the gyroscope. It was found from the uniform field, which turns in the frame of the "
    "sensors as the angular velocity says."
)


_SETTLED = 0.9
"""Noise that the errors leave, over the one that they were fitted with, from which it counts as the same."""


def maximum_a_posteriori(recording: SampleSource, array: Array, known: Known) -> Calibration:
    """Return the most probable errors by a recording and what else is known.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field; without any scalar reading the intensity is an unknown constant.
    array : Array
        Geometry and noise; a noise that is not stated is estimated, and scaled to the residual before the fit that
        weighs data and prior. Where it states the standard deviation of the attitude, the recorded attitude is data.
        Where it states that of the mounting of attitude or gyroscope, the array frame is theirs, if that is then known
        to ``LARGEST_ANGLE_ERROR``.
    known : Known
        What else is known; it is taken as it is.

    Returns
    -------
    Calibration
        With the covariance of all together.

    Raises
    ------
    InputError
        When there is no prior, and the readings determine no ellipsoid to start from.
    Refused
        When the iteration does not settle.
    """
    noisy, posterior, is_estimated = with_noise(recording, array, known)
    if array.vector_noise_T is None:
        noisy = noise_left_in(recording, noisy, posterior.errors, posterior.intensity_T)
        posterior = posterior_of(recording, noisy, known)
    frame = FIRST_SENSOR if known.prior is None else known.prior.calibration.frame
    errors, covariance = posterior.errors, posterior.covariance
    if posterior.mount is not None and noisy.mounting_error is not None and not known.knows_frame:
        in_frame, with_turn = _into_frame_of_attitude(posterior, noisy.mounting_error)
        # A frame that is less certain than misalignments may be is none: that of sensor 1 is certain.
        if np.sqrt(np.diag(with_turn)).reshape(-1, 12)[:, 9:].max() <= LARGEST_ANGLE_ERROR:
            errors, covariance = in_frame, with_turn
            frame = FRAME_STATEMENT if known.gyroscope is None else FRAME_OF_GYROSCOPE
    estimate = Estimate(errors, covariance, True, posterior.intensity_T, frame=frame)
    calibration = with_variance_factors(make_calibration(NAME, recording, noisy, estimate), known.variance_factors)
    has_scale = calibration.has_scalar_reference or known.knows_scale
    return replace(calibration, noise_is_estimated=is_estimated, has_scalar_reference=has_scale)


def _into_frame_of_attitude(posterior: Posterior, mounting_error: float) -> tuple[SensorErrors, FloatArray]:
    """Return errors in the frame whose attitude or angular velocity was recorded, with their covariance."""
    assert posterior.mount is not None and posterior.with_mount is not None
    errors, derivative = turned(posterior.errors, posterior.mount.T)
    derivative[:, -3:] *= -1  # the transposed rotation turns back
    joint = posterior.with_mount.copy()
    joint[-3:, -3:] += mounting_error**2 * np.eye(3)
    return errors, derivative @ joint @ derivative.T


def with_noise(recording: SampleSource, array: Array, known: Known) -> tuple[KnownNoiseArray, Posterior, bool]:
    """Return the array with every noise known, the errors that go with it, and whether a noise was estimated.

    Attitudes that jump pass for noise where none is stated. With it a prior would count alone, whatever the readings
    contradict it in: it is scaled down to what the errors leave.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Its noise stated or not.
    known : Known
        What else is known.

    Raises
    ------
    InputError, Refused
        As of ``posterior_of``.
    """
    noisy, is_estimated = complete_noise(array, recording)
    posterior = posterior_of(recording, noisy, known)
    # 10: of a noise that is not stated, down to what the errors leave.
    for _ in range(10 if array.vector_noise_T is None else 0):
        left = noise_left_in(recording, noisy, posterior.errors, posterior.intensity_T)
        if left.vector_noise_T[0] > _SETTLED * noisy.vector_noise_T[0]:
            break
        noisy, posterior = left, posterior_of(recording, left, known)
    return noisy, posterior, is_estimated


def noise_left_in(
    recording: SampleSource, noisy: KnownNoiseArray, errors: SensorErrors, intensity_T: float
) -> KnownNoiseArray:
    """Return an array with the vector noise that given errors leave between its sensors, or against the intensity.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of its sensors.
    noisy : KnownNoiseArray
        With noises of which the ratios are kept.
    errors : SensorErrors
        Of the sensors.
    intensity_T : float
        Of the field where no scalar reads it, tesla.
    """
    chi_square = measure_chi_square(recording, noisy, errors, intensity_T)
    factor = np.sqrt(chi_square.get("differential", chi_square.get("common_mode", 1.0)))
    return replace(noisy, vector_noise_T=factor * noisy.vector_noise_T)


def update_of(
    calibration: Calibration,
    prior: Prior,
    used: Prior,
    chi_square: float,
    freedom: int,
    moved: tuple[Moved, ...] = (),
) -> Update:
    """Return how a calibration came from its prior.

    Parameters
    ----------
    calibration : Calibration
        Of a recording and the prior.
    prior : Prior
        As it was given.
    used : Prior
        That was used: widened where something moved.
    chi_square : float
        Of the difference between prior and data.
    freedom : int
        Number of independent directions that it counts.
    moved : tuple of Moved
        What was found to have moved.
    """
    source = prior.calibration.source
    return Update(
        prior=prior.calibration.method if source is None else source.name,
        rates=prior.rates,
        elapsed_s=prior.elapsed_s,
        warming_K=prior.warming_K,
        prior_standard_errors=prior.standard_errors,
        data_share=_data_share(calibration, used),
        chi_square=chi_square,
        freedom=freedom,
        probability=probability_of(chi_square, freedom),
        moved=moved,
    )


def _data_share(calibration: Calibration, prior: Prior) -> FloatArray:
    """Return the part of the information on each parameter that is not the prior's, (K, 12)."""
    assert calibration.covariance is not None
    _, derivative = prior.in_convention(calibration.errors)
    after = np.diag(derivative @ calibration.covariance @ derivative.T)
    before = np.diag(prior.covariance)
    ratio = np.divide(after, before, out=np.full_like(before, np.nan), where=before > 0)
    return np.asarray(np.clip(1 - ratio, 0, 1).reshape(-1, 12))
