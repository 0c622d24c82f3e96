"""From an estimate to a calibration: noise, residuals, floor, whiteness and coverage, the same for every method."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.array import Array
from tam_calibration.calibration import FRAME_STATEMENT, AmbientGradient, Calibration
from tam_calibration.fit.ambient_gradient import as_if_uniform
from tam_calibration.fit.noise import complete_noise
from tam_calibration.fit.quality import measure_chi_square, measure_quality
from tam_calibration.recording import SampleSource
from tam_calibration.residuals import noise_floor
from tam_calibration.sensor_errors import SensorErrors
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


def make_calibration(method: str, source: SampleSource, array: Array, estimate: Estimate) -> Calibration:
    """Return the calibration of an estimate.

    An estimated vector noise is scaled so that the whitened channels have unit variance, and the covariance with it.
    """
    noisy, noise_is_estimated = complete_noise(array, source)
    errors, covariance, gradient = estimate.errors, estimate.covariance, estimate.ambient_gradient
    seen = as_if_uniform(source, errors, array, gradient)
    raw = measure_quality(source, noisy, errors, estimate.intensity_T)
    uniform = raw if seen is source else measure_quality(seen, noisy, errors, estimate.intensity_T)
    chi_square = uniform.reduced_chi_square
    if array.vector_noise_T is None and noisy.vector_noise_T is not None and chi_square:
        factor = float(np.sqrt(chi_square.get("differential", chi_square.get("common_mode", 1.0))))
        noisy = replace(noisy, vector_noise_T=factor * noisy.vector_noise_T)
        covariance = factor**2 * covariance if estimate.covariance_from_noise else covariance
        if gradient is not None:
            gradient = replace(gradient, standard_errors_T_per_m=factor * gradient.standard_errors_T_per_m)
        chi_square = measure_chi_square(seen, noisy, errors, estimate.intensity_T)
    return Calibration(
        method=method,
        array=noisy,
        noise_is_estimated=noise_is_estimated,
        errors=errors,
        covariance=covariance,
        has_scalar_reference=source.scalar_count is not None,
        intensity_T=estimate.intensity_T if uniform.mean_scalar_T is None else uniform.mean_scalar_T,
        before=raw.before,
        in_sample=uniform.after,
        floor=noise_floor(errors, noisy, noisy.scalar_noise_T or 0.0),
        samples=source.sample_count,
        time_span_s=source.time_span_s,
        coverage=raw.coverage,
        reduced_chi_square=chi_square,
        ambient_gradient=gradient,
        frame=estimate.frame,
    )
