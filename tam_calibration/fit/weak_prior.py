"""The calibration with a weak prior, which leaves errors open: tolerances of new sensors, or a narrow turn.

Where the turn leaves much to such a prior, a fit that takes residuals for less than they are leaves it by many of its
deviations, and may not settle. The fit therefore comes from above: it begins as if the readings contained hardly any
information, measures its residuals, and weighs the readings by these the next time. At the end the curvature that
lengths have over errors so uncertain is added to the covariance.
"""

from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import complete_noise
from tam_calibration.core.slow_cosines import VarianceFactors
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.parts import Update
from tam_calibration.fit.consistency import Fit
from tam_calibration.fit.estimate import Estimate, make_calibration, measure_chi_square
from tam_calibration.fit.identifiability import open_parameters, require_accurate
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, noise_left_in, update_of
from tam_calibration.fit.maximum_likelihood import maximum_likelihood
from tam_calibration.fit.prior import Prior, in_first_frame
from tam_calibration.fit.problem import Known, Place, Problem
from tam_calibration.fit.slow_residuals import variance_factors
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

NAME = "tolerances"
"""Method of the calibration that tolerances make: of sensors without errors."""

_MOST_WEIGHINGS = 20
"""From above, of the weight of the readings, and of curvature: fourteen were the most that were needed."""


_DRAWS, _SAMPLES, _SEED = 100, 1000, 0
"""Draws and samples by which curvature is measured, twice as many as there are errors; and the seed of the draws."""

SETTLED = 0.1
"""Part by which the variance may exceed that which the residuals show, or the readings were weighed by: 5 % of the
standard errors."""


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
    nominal = make_calibration(NAME, recording, array, Estimate(errors, covariance, False, intensity_T))
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
    prior = known.prior
    assert prior is not None
    noisy, is_estimated = complete_noise(array, recording)
    settled, calibration = _settled(replace(known, start=_plain_fit(recording, noisy)), recording, noisy)
    # 2: of a noise that is not stated to what is left: with a prior that is contradicted it would grow without end.
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
    calibration = replace(calibration, update=update, warnings=_left_open(calibration, update))
    return calibration, settled, lambda samples, _: maximum_a_posteriori(samples, noisy, settled)


def _plain_fit(recording: SampleSource, array: KnownNoiseArray) -> Calibration | None:
    """Return the fit of the readings alone, where they determine one: its errors may be any, and far from the prior's.

    From there the way is short; from no errors those of ten times the field are not found.
    """
    try:
        calibration = maximum_likelihood(recording, array)
        require_accurate(calibration, recording)
    except (InputError, Refused):
        return None
    return calibration


def _settled(known: Known, recording: SampleSource, array: KnownNoiseArray) -> tuple[Known, Calibration]:
    """Return what is known, with the weight of the readings that their residuals show, and the calibration by it."""
    assert known.prior is not None
    start = known.start or known.prior.calibration
    energy = max([1.0, *measure_chi_square(recording, array, start.errors, start.intensity_T).values()])
    factors = VarianceFactors(recording.sample_count * energy, recording.sample_count * energy)
    for _ in range(_MOST_WEIGHINGS):
        known = replace(known, variance_factors=factors)
        calibration = maximum_a_posteriori(recording, array, known)
        measured = variance_factors(calibration, recording)
        if measured.is_near(factors, SETTLED):
            break
        # 10.0: of the variance from one round to the next: what a fit far above leaves tells too little, and a fit that
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


def _left_open(calibration: Calibration, update: Update) -> tuple[str, ...]:
    """Return what the readings leave to the prior, in a sentence, or nothing."""
    names = open_parameters(calibration.standard_errors.ravel(), calibration.intensity_T)
    if not names:
        return ()
    return (
        f"the readings do not determine {names}: this is left to {update.prior_in_words}; turn the array further, and "
        "take this calibration for a prior",
    )
