"""What the tolerances of new sensors tell before any calibration, and the fit of a recording beside them.

A data sheet tells little. Where a narrow turn leaves much to it, a fit that takes residuals for less than they are
leaves the tolerances by many of their deviations, and may not settle. The fit therefore comes from above: it begins
as if the readings told hardly anything, measures what it leaves, and weighs the readings by that the next time.
"""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.linalg import norm

from tam_calibration.core.noise import complete_noise
from tam_calibration.correction.calibration import Calibration
from tam_calibration.correction.update import Update
from tam_calibration.fit.contradiction import SIGNIFICANT
from tam_calibration.fit.estimate import Estimate, make_calibration, measure_chi_square
from tam_calibration.fit.identifiability import open_parameters
from tam_calibration.fit.information import inverted
from tam_calibration.fit.maximum_a_posteriori import maximum_a_posteriori, noise_left_in, update_of
from tam_calibration.fit.posterior import Known, Place, Problem
from tam_calibration.fit.prior import Prior, in_first_frame
from tam_calibration.fit.slow_residuals import variance_factor
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.recording import SKETCH, SampleSource
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray

NAME = "tolerances"
"""Method of the calibration that tolerances make: of sensors without errors."""

_MOST_ROUNDS = 20
"""From above; six were the most that were needed."""

_LARGEST_FALL = 10.0
"""Of the variance from one round to the next: what a fit far above leaves tells too little, and a fit that follows it
takes what is slow for errors of the sensors."""

_DRAWS, _SAMPLES, _SEED = 32, 1000, 0
"""Draws and samples by which curvature is measured, to a quarter of its variance; and the seed of the draws."""

_SETTLED = 0.1
"""Part by which the variance may exceed that which the residuals show: 5 % of the standard errors."""


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


def beside_tolerances(
    recording: SampleSource, array: Array, main_field_T: FloatArray | None
) -> tuple[Calibration, Callable[[SampleSource, Array], Calibration]]:
    """Return the calibration of a recording beside the tolerances of its array, and the fit that made it.

    Parameters
    ----------
    recording : SampleSource
        Raw readings of K sensors in a uniform field.
    array : Array
        Geometry, noise and tolerances.
    main_field_T : (3,) array, optional
        Of a model where the recording was made, east, north, up, tesla.

    Raises
    ------
    InputError
        When the readings cannot be used.
    Refused
        When no weight of the readings lets the fit settle, or they contradict the tolerances and leave something open
        to them: neither would tell it.
    """
    prior = prior_of_tolerances(recording, array)
    noisy, is_estimated = complete_noise(array, recording)
    known, calibration = _settled(Known(prior, main_field_T), recording, noisy)
    for _ in range(_MOST_ROUNDS if array.vector_noise_T is None else 0):
        before = noisy.vector_noise_T
        noisy = noise_left_in(recording, noisy, calibration.errors, calibration.intensity_T)
        if np.allclose(noisy.vector_noise_T, before, rtol=_SETTLED, atol=0):
            break
        known, calibration = _settled(known, recording, noisy)
    known = replace(known, curvature=_curvature(calibration, recording, known))

    def fit(samples: SampleSource, _: Array) -> Calibration:
        return replace(maximum_a_posteriori(samples, noisy, known), noise_is_estimated=is_estimated)

    calibration = fit(recording, array)
    # Directions that the readings tell, which other priors are judged by, are no straight lines here.
    energy, uncertain = prior.terms(calibration.errors).energy, int(np.count_nonzero(prior.standard_errors))
    update = update_of(calibration, prior, prior, energy, uncertain)
    return replace(calibration, update=update, warnings=_told(calibration, update)), fit


def _settled(known: Known, recording: SampleSource, array: KnownNoiseArray) -> tuple[Known, Calibration]:
    """Return what is known, with the weight of the readings that their residuals show, and the calibration by it."""
    assert known.prior is not None
    nominal = known.prior.calibration
    chi_square = measure_chi_square(recording, array, nominal.errors, nominal.intensity_T)
    energy = max(1.0, *chi_square.values())
    known, found = replace(known, variance_factor=recording.sample_count * energy), None
    for _ in range(_MOST_ROUNDS):
        try:
            calibration = maximum_a_posteriori(recording, array, known)
        except Refused:
            if found is None:
                raise
            break
        factor, measured = known.variance_factor, variance_factor(calibration, recording)
        if measured <= (1 + _SETTLED) * factor:
            found = known, calibration
        if abs(measured - factor) <= _SETTLED * factor:
            break
        known = replace(known, variance_factor=max(measured, factor / _LARGEST_FALL))
    if found is None:
        raise Refused("...")
    return found


def _curvature(calibration: Calibration, recording: SampleSource, known: Known) -> float:
    """Return by how much the variance of what the readings tell is larger, since it is no straight line.

    Errors of the size of tolerances bend lengths by more than the noise. Where a narrow turn leaves them open, the
    score at errors that are drawn from what is known after the fit is not what the information makes of them.
    """
    some = recording.thinned(_SAMPLES)
    problem = Problem.of(some, calibration.array, known)
    place = Place(calibration.errors, calibration.intensity_T)
    basis, size = problem.basis_at(place), recording.sample_count / some.sample_count
    information, score = (size * each for each in problem.data_at(place))
    deviates = np.random.default_rng(_SEED).normal(size=(_DRAWS, len(score)))
    curvature = 1.0
    for _ in range(_MOST_ROUNDS):
        covariance = inverted(problem.information_at(place, curvature / size), basis)
        values, vectors = np.linalg.eigh(covariance)
        steps = deviates * np.sqrt(np.maximum(values, 0)) @ vectors.T
        scores = np.array([size * problem.data_at(problem.moved(place, step))[1] for step in steps])
        left = scores - score + steps @ information
        moved = np.einsum("di,ij,dj->", left, covariance, left) / _DRAWS
        before, curvature = curvature, 1 + float(moved / np.trace(covariance @ information))
        if curvature <= (1 + _SETTLED) * before:
            break
    return curvature


def _told(calibration: Calibration, update: Update) -> tuple[str, ...]:
    """Return whether the readings contradict the tolerances, and what they leave to them."""
    names = open_parameters(calibration.standard_errors.ravel(), calibration.intensity_T)
    difference = f"χ² {update.chi_square:.3g} of {update.freedom} errors"
    is_contradicted = update.probability < SIGNIFICANT
    if names and is_contradicted:
        raise Refused(
            f"the readings contradict the tolerances of the array file, {difference}, and do not determine {names}: "
            "state the noise that the readings have, larger tolerances, and the rotations of sensors that are turned"
        )
    if is_contradicted:
        return (f"the readings contradict the tolerances of the array file, {difference}, and count alone",)
    if names:
        return (
            f"the readings do not determine {names}: this is left to the tolerances of the array file; turn the array "
            "further, and take this calibration for a prior",
        )
    return ()
