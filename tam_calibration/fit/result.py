"""From an estimate to a calibration: noise, residuals, floor, whiteness and coverage, the same for every method."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.array import Array
from tam_calibration.calibration import FRAME_STATEMENT, AmbientGradient, Calibration
from tam_calibration.errors import SensorErrors
from tam_calibration.fit.ambient_gradient import as_if_uniform
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.fit.likelihood import Likelihood
from tam_calibration.fit.noise import complete_noise
from tam_calibration.recording import Recording
from tam_calibration.residuals import measure_residuals, noise_floor
from tam_calibration.units import FloatArray


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a method finds.

    Parameters
    ----------
    errors : SensorErrors
        The estimate.
    covariance : (12 K, 12 K) array
        Of the flattened parameters.
    covariance_from_noise : bool
        Whether the covariance comes from the array's noise, not from the scatter of the data.
    intensity_T : float
        The constant intensity on the estimate's scale, used where there is no scalar reference.
    ambient_gradient : AmbientGradient, optional
        Fitted beside the errors; its standard errors come from the array's noise.
    frame : str
        What the array frame of the errors is.
    """

    errors: SensorErrors
    covariance: FloatArray
    covariance_from_noise: bool
    intensity_T: float
    ambient_gradient: AmbientGradient | None = None
    frame: str = FRAME_STATEMENT


def make_calibration(method: str, recording: Recording, array: Array, estimate: Estimate) -> Calibration:
    """Return the calibration of an estimate.

    An estimated vector noise is scaled so that the whitened channels have unit variance, and the covariance with it.
    """
    noisy, noise_is_estimated = complete_noise(array, recording)
    covariance, gradient = estimate.covariance, estimate.ambient_gradient
    uniform = as_if_uniform(recording, estimate.errors, array, gradient)
    scalar = uniform.scalar_T
    intensity = estimate.intensity_T if scalar is None else float(np.nanmean(scalar))
    chi_square = _reduced_chi_square(uniform, noisy, estimate)
    if array.vector_noise_T is None and noisy.vector_noise_T is not None and chi_square:
        factor = float(np.sqrt(chi_square.get("differential", chi_square.get("common_mode", 1.0))))
        noisy = replace(noisy, vector_noise_T=factor * noisy.vector_noise_T)
        covariance = factor**2 * covariance if estimate.covariance_from_noise else covariance
        if gradient is not None:
            gradient = replace(gradient, standard_errors_T_per_m=factor * gradient.standard_errors_T_per_m)
        chi_square = _reduced_chi_square(uniform, noisy, estimate)
    none = SensorErrors.none(recording.sensor_count)
    return Calibration(
        method=method,
        array=noisy,
        noise_is_estimated=noise_is_estimated,
        errors=estimate.errors,
        covariance=covariance,
        has_scalar_reference=scalar is not None,
        intensity_T=intensity,
        before=measure_residuals(none, array, recording, intensity),
        in_sample=measure_residuals(estimate.errors, array, uniform, intensity),
        floor=noise_floor(estimate.errors, noisy, noisy.scalar_noise_T or 0.0),
        samples=recording.sample_count,
        time_span_s=(float(recording.time_s[0]), float(recording.time_s[-1])),
        coverage=measure_coverage(field_of(recording, estimate.errors)).fraction,
        reduced_chi_square=chi_square,
        ambient_gradient=gradient,
        frame=estimate.frame,
    )


def _reduced_chi_square(recording: Recording, array: Array, estimate: Estimate) -> dict[str, float]:
    assert array.vector_noise_T is not None
    unit, count = estimate.intensity_T, recording.sensor_count
    scalar = np.full(recording.sample_count, unit) if recording.scalar_T is None else recording.scalar_T
    # About the biases, so that one that is many times the field costs no digits.
    unbiased = (recording.readings_T - estimate.errors.bias_T) / unit
    scalar_noise = (array.scalar_noise_T or 0.0) / unit
    likelihood = Likelihood(unbiased, scalar / unit, array.vector_noise_T / unit, scalar_noise)
    point = likelihood.linearize(estimate.errors.matrix, np.zeros((count, 3)))
    # The ellipsoid takes nine parameters from the common mode, each further sensor twelve from the differences.
    freedom = {"differential": recording.sample_count * (3 * count - 3) - 12 * (count - 1)}
    freedom["common_mode"] = point.reference_count - 9
    energy = {"differential": point.differential, "common_mode": point.common_mode}
    return {name: energy[name] / freedom[name] for name in freedom if freedom[name] > 0}
