"""The calibration of a recording and of what else is known: a prior, attitude, a main field.

A weak prior leaves errors open: tolerances of new sensors, or a narrow turn. Where the turn leaves much to it, a fit
that takes residuals for less than they are leaves it by many of its deviations, and may not settle. The fit therefore
comes from above: it begins as if the readings contained hardly any information, measures its residuals, and weighs the
readings by these the next time. At the end the curvature that lengths have over errors so uncertain is added to the
covariance.
"""

from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import VarianceFactors, complete_noise
from tam_calibration.correction.acceptance import LARGEST_ANGLE_ERROR
from tam_calibration.correction.calibration import FRAME_STATEMENT as FIRST_SENSOR
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Moved, Update
from tam_calibration.fit.consistency import Fit
from tam_calibration.fit.contradiction import probability_of
from tam_calibration.fit.estimate import make_calibration, measure_chi_square, variance_factors, with_variance_factors
from tam_calibration.fit.identifiability import open_parameters, require_accurate
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import Prior, in_first_frame, turned
from tam_calibration.fit.problem import Known, Place, Posterior, Problem, posterior_of
from tam_calibration.fit.recorded_attitude import FRAME_STATEMENT
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.geomagnetic_field import OF_IGRF
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

FRAME_OF_GYROSCOPE = (
    "The array frame is that of the gyroscope. It was found from the uniform field, which turns in the frame of the "
    "sensors as the angular velocity says."
)


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
    if posterior.motion is not None and noisy.mounting_error is not None and not known.knows_frame:
        assert posterior.with_mount is not None
        in_frame, derivative = turned(errors, posterior.motion.mounting[0].T)
        derivative[:, -3:] *= -1  # the transposed rotation turns back
        joint = posterior.with_mount.copy()
        joint[-3:, -3:] += noisy.mounting_error**2 * np.eye(3)
        with_turn = derivative @ joint @ derivative.T
        # A frame that is less certain than misalignments may be is none: that of sensor 1 is certain.
        if np.sqrt(np.diag(with_turn)).reshape(-1, 12)[:, 9:].max() <= LARGEST_ANGLE_ERROR:
            errors, covariance = in_frame, with_turn
            frame = FRAME_STATEMENT if known.gyroscope is None else FRAME_OF_GYROSCOPE
    name, intensity_T = "maximum_a_posteriori", posterior.intensity_T
    calibration = make_calibration(name, recording, noisy, errors, covariance, intensity_T, frame=frame)
    calibration = with_variance_factors(calibration, known.variance_factors)
    if known.knows_scale and not calibration.has_scalar_reference:
        reference = "the prior's scale" if known.main_field_T is None else OF_IGRF
        calibration = replace(calibration, has_scalar_reference=True, reference=reference)
    return replace(calibration, noise_is_estimated=is_estimated)


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
    # Of a noise that is not stated, down to what the errors leave.
    for _ in range(10 if array.vector_noise_T is None else 0):
        left = noise_left_in(recording, noisy, posterior.errors, posterior.intensity_T)
        if left.vector_noise_T[0] > (1 - SETTLED) * noisy.vector_noise_T[0]:
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
    calibration: Calibration, prior: Prior, used: Prior, chi_square: float, freedom: int, moved: tuple[Moved, ...] = ()
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
    source, (_, derivative) = prior.calibration.source, used.in_convention(calibration.errors)
    after, before = np.diag(derivative @ calibration.covariance @ derivative.T), np.diag(used.covariance)
    ratio = np.divide(after, before, out=np.full_like(before, np.nan), where=before > 0)
    return Update(
        prior=prior.calibration.method if source is None else source.name,
        rates=prior.rates,
        elapsed_s=prior.elapsed_s,
        warming_K=prior.warming_K,
        prior_standard_errors=prior.standard_errors,
        data_share=np.clip(1 - ratio, 0, 1).reshape(-1, 12),
        chi_square=chi_square,
        freedom=freedom,
        probability=probability_of(chi_square, freedom),
        moved=moved,
    )


_MOST_WEIGHINGS = 20
"""From above, of the weight of the readings, and of curvature: fourteen were the most that were needed."""


_DRAWS, _SAMPLES, _SEED = 100, 1000, 0
"""Draws and samples by which curvature is measured, twice as many as there are errors; and the seed of the draws."""

SETTLED = 0.1
"""Part by which the noise may be less than that of the fit before, or the variance exceed what the residuals show,
or the readings were weighed by: 5 % of the standard errors."""


def prior_of_tolerances(recording: SampleSource, array: Array) -> Prior:
    """Return what the tolerances of an array tell of the errors of its sensors.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors that it goes with; a noise that is not stated is what they leave without errors.
    array : Array
        With tolerances.
    """
    assert array.tolerances is not None
    errors = SensorErrors.none(array.sensor_count)
    # In the frame of sensor 1 a turn of it turns all others.
    _, derivative = in_first_frame(errors)
    covariance = derivative * np.tile(array.tolerances.variances(), array.sensor_count) @ derivative.T
    intensity_T = float(np.mean(norm(recording.thinned(SKETCH).readings_T, axis=2)))
    nominal = make_calibration("tolerances", recording, array, errors, covariance, intensity_T)
    return Prior(nominal, covariance, None, None, None)


def is_weak(prior: Prior) -> bool:
    """Whether a prior leaves errors open: it is that of tolerances, or of a calibration that would not do alone.

    One that would, and has aged, is not weak: what moved since then is looked for.
    """
    stored = prior.calibration
    return prior.rates is None or bool(open_parameters(stored.standard_errors.ravel(), stored.intensity_T))


def calibrate_with_weak_prior(recording: SampleSource, array: Array, known: Known) -> tuple[Calibration, Known, Fit]:
    """Return the calibration of a recording with a weak prior, with the weight of the readings, and the fit.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry and noise.
    known : Known
        With the prior.

    Raises
    ------
    InputError
        When the readings cannot be used.
    Refused
        When the fit does not settle.
    """
    prior = known.given
    noisy, is_estimated = complete_noise(array, recording)
    plain = None
    with suppress(InputError, Refused):
        # The errors may be any. From the fit of the readings alone, where they determine one, the way is short; from no
        # errors those of ten times the field are not found.
        plain = require_accurate(maximum_likelihood(recording, noisy), recording)
    settled, calibration = _settled(replace(known, start=plain), recording, noisy)
    # Of a noise that is not stated to what is left: with a prior that is contradicted it would grow without end.
    for _ in range(2 if array.vector_noise_T is None else 0):
        before = noisy.vector_noise_T
        noisy = noise_left_in(recording, noisy, calibration.errors, calibration.intensity_T)
        if np.allclose(noisy.vector_noise_T, before, rtol=SETTLED, atol=0):
            break
        settled, calibration = _settled(settled, recording, noisy)
    curved = replace(settled, curvature=_curvature(calibration, recording, settled))
    calibration = replace(maximum_a_posteriori(recording, noisy, curved), noise_is_estimated=is_estimated)
    # Directions that the readings tell, which other priors are judged by, are no straight lines here.
    energy, uncertain = prior.terms(calibration.errors).energy, int(np.count_nonzero(prior.standard_errors))
    update = update_of(calibration, prior, prior, energy, uncertain)
    warnings: tuple[str, ...] = ()
    if names := open_parameters(calibration.standard_errors.ravel(), calibration.intensity_T):
        left = f"the readings do not determine {names}: this is left to {update.prior_in_words}"
        warnings = (f"{left}; turn the array further, and take this calibration for a prior",)
    calibration = replace(calibration, update=update, warnings=warnings)
    return calibration, settled, lambda samples, _: maximum_a_posteriori(samples, noisy, settled)


def _settled(known: Known, recording: SampleSource, array: KnownNoiseArray) -> tuple[Known, Calibration]:
    """Return what is known, with the weight of the readings that their residuals show, and the calibration by it."""
    start = known.start or known.given.calibration
    energy = max([1.0, *measure_chi_square(recording, array, start.errors, start.intensity_T).values()])
    factors = VarianceFactors(recording.sample_count * energy, recording.sample_count * energy)
    for _ in range(_MOST_WEIGHINGS):
        known = replace(known, variance_factors=factors)
        calibration = maximum_a_posteriori(recording, array, known)
        measured = variance_factors(calibration, recording)
        if np.allclose(measured, factors, rtol=SETTLED, atol=0):
            break
        # Of the variance from one round to the next: what a fit far above leaves tells too little, and a fit that
        # follows it takes what is slow for errors of the sensors.
        factors = measured.at_least(factors.times(1 / 10.0))
    else:
        raise Refused(
            "the weight of the readings against the prior does not settle: turn the array further, or "
            "state the noise that they have"
        )
    return known, calibration


def _curvature(calibration: Calibration, recording: SampleSource, known: Known) -> FloatArray:
    """Return the covariance (Q, Q) of what the score is at errors that may be, less what the information makes of them.

    Errors of the size of tolerances bend lengths by more than the noise. Where a narrow turn leaves them open, this is
    an error of what the readings tell that is the same in all samples: a statistical linear regression of the score
    over what is known after the fit (García-Fernández et al., posterior linearization filter, 2015) adds it to the
    noise.
    """
    some = recording.thinned(_SAMPLES)
    weight = known.variance_factors.times(some.sample_count / recording.sample_count)
    problem = Problem.of(some, calibration.array, replace(known, variance_factors=weight))
    place = Place(calibration.errors, calibration.intensity_T)
    basis, here = problem.basis_at(place), problem.data_at(place)
    deviates = np.random.default_rng(_SEED).normal(size=(_DRAWS, len(basis)))
    curvature = np.zeros_like(here.information)
    for _ in range(_MOST_WEIGHINGS):
        covariance = inverted(problem.information_with(curvature, place), basis)
        values, vectors = np.linalg.eigh(covariance)
        steps = deviates * np.sqrt(np.maximum(values, 0)) @ vectors.T
        scores = np.array([problem.data_at(problem.moved(place, step)).score for step in steps])
        left = scores - here.score + steps @ here.information
        before, curvature = curvature, left.T @ left / _DRAWS
        if np.sum(covariance * curvature) <= (1 + SETTLED) * np.sum(covariance * before):
            break
    return curvature
