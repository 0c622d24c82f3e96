"""From an estimate to a calibration: noise, residuals, floor, whiteness and coverage, for every method."""

from dataclasses import dataclass, replace

import numpy as np

from tam_calibration.core.noise import complete_noise
from tam_calibration.core.slow_cosines import VarianceFactors
from tam_calibration.correction.calibration import FRAME_STATEMENT, AmbientGradientEstimate, Calibration
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.fit.likelihood import ChannelMaps, energies
from tam_calibration.fit.recorded_attitude import as_if_uniform
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import SKETCH, Block, SampleSource
from tam_calibration.model.residuals import Residuals, ResidualSums, noise_floor
from tam_calibration.model.sensor_errors import SensorErrors
from tam_calibration.model.units import FloatArray


@dataclass(frozen=True, eq=False)
class Figures:
    """The figures of one pass.

    Parameters
    ----------
    before, after : Residuals
        Of the raw and of the corrected readings.
    reduced_chi_square : dict
        As in ``Calibration``.
    mean_scalar_T : float, optional
        Mean scalar reading, tesla; None where there is no scalar channel.
    """

    before: Residuals
    after: Residuals
    reduced_chi_square: dict[str, float]
    mean_scalar_T: float | None


def measure_quality(source: SampleSource, array: KnownNoiseArray, errors: SensorErrors, intensity_T: float) -> Figures:
    """Return the figures of a recording in a uniform field that was corrected with given errors.

    Parameters
    ----------
    source : SampleSource
        Raw readings.
    array : Array
        Geometry, and every noise.
    errors : SensorErrors
        The estimate.
    intensity_T : float
        Stands in where there is no scalar channel.
    """
    before = ResidualSums(SensorErrors.none(errors.sensor_count), array, intensity_T)
    after = ResidualSums(errors, array, intensity_T)
    energy = EnergySums(errors, array, intensity_T)
    scalar_T, count = 0.0, source.scalar_count
    for block in source.blocks():
        for sums in (before, after, energy):
            sums.add(block)
        if block.scalar_T is not None:
            scalar_T += float(np.nansum(block.scalar_T))
    mean_scalar_T = scalar_T / count if count else None
    return Figures(before.result(), after.result(), energy.reduced_chi_square(), mean_scalar_T)


def measure_chi_square(
    source: SampleSource, array: KnownNoiseArray, errors: SensorErrors, intensity_T: float
) -> dict[str, float]:
    """Return the reduced chi-square alone, as ``measure_quality`` does.

    Parameters
    ----------
    source : SampleSource
        Raw readings, an ambient gradient taken off.
    array : KnownNoiseArray
        Geometry, and every noise.
    errors : SensorErrors
        The estimate.
    intensity_T : float
        Intensity of the field where there is no scalar channel, tesla.

    Returns
    -------
    dict
        Energies per degree of freedom of the channels "differential" and "common_mode", without those that have no
        degree of freedom.
    """
    energy = EnergySums(errors, array, intensity_T)
    for block in source.blocks():
        energy.add(block)
    return energy.reduced_chi_square()


class EnergySums:
    """The energy of the whitened channels: differences between sensors, and the field they agree on over the intensity.

    Parameters
    ----------
    errors : SensorErrors
        The estimate.
    array : Array
        With every noise.
    intensity_T : float
        Stands in where there is no scalar channel.
    """

    def __init__(self, errors: SensorErrors, array: KnownNoiseArray, intensity_T: float) -> None:
        self._intensity_T, self._scalar_noise_T, self._sensors = intensity_T, array.scalar_noise_T, errors.sensor_count
        self._channels = ChannelMaps.of_uniform_field(errors.matrix, errors.bias_T, array.vector_noise_T)
        self._energy, self._counts = np.zeros(2), np.zeros(2, dtype=int)

    def add(self, block: Block) -> None:
        """Add the samples of a block."""
        own = self.of_samples(block)
        self._energy += np.nansum(own, axis=1)
        self._counts += np.isfinite(own).sum(axis=1)

    def of_samples(self, block: Block) -> FloatArray:
        """Return each sample's squared residuals (2, N): differential channels and common mode; NaN without one."""
        count = len(block.readings_T)
        intensity_T = np.full(count, self._intensity_T) if block.scalar_T is None else block.scalar_T
        return energies(self._channels, block.readings_T.reshape(count, -1).T, intensity_T, self._scalar_noise_T)

    def reduced_chi_square(self) -> dict[str, float]:
        """Return the energies per degree of freedom, where there are any."""
        # The ellipsoid takes nine parameters from the common mode, each further sensor twelve from the differences.
        others = self._sensors - 1
        freedom = np.array([3 * others, 1]) * self._counts - np.array([12 * others, 9])
        names = ("differential", "common_mode")
        each = zip(names, self._energy.tolist(), freedom.tolist(), strict=True)
        return {name: energy / free for name, energy, free in each if free > 0}


def sample_energies(
    source: SampleSource, array: KnownNoiseArray, factors: VarianceFactors, errors: SensorErrors, intensity_T: float
) -> FloatArray:
    """Return the (N,) squares of the residuals of each sample over their variances.

    Parameters
    ----------
    source : SampleSource
        Raw readings.
    array : KnownNoiseArray
        Geometry, and every noise.
    factors : VarianceFactors
        By how much the channels vary more than by that noise.
    errors : SensorErrors
        The estimate.
    intensity_T : float
        Stands in where there is no scalar channel.
    """
    energy = EnergySums(errors, array, intensity_T)
    differential, common_mode = np.concatenate([energy.of_samples(block) for block in source.blocks()], axis=1)
    return np.asarray(differential / factors.differential + np.nan_to_num(common_mode) / factors.common_mode)


def make_calibration(
    method: str,
    source: SampleSource,
    array: Array,
    errors: SensorErrors,
    covariance: FloatArray,
    intensity_T: float,
    *,
    is_from_noise: bool = False,
    gradient: AmbientGradientEstimate | None = None,
    frame: str = FRAME_STATEMENT,
) -> Calibration:
    """Return the calibration of an estimate.

    An estimated vector noise is scaled so that the whitened channels have unit variance, and the covariance with it.

    Parameters
    ----------
    method : str
        Name of the method that made the estimate.
    source : SampleSource
        Raw readings that it was made from.
    array : Array
        Geometry and noise of the K sensors; a noise that is not stated is estimated.
    errors : SensorErrors
        The estimate.
    covariance : (12 K, 12 K) array
        Of the flattened parameters.
    intensity_T : float
        The constant intensity on the estimate's scale, tesla, used where there is no scalar reference.
    is_from_noise : bool
        Whether the covariance comes from the array's noise, not from the scatter of the data.
    gradient : AmbientGradientEstimate, optional
        Fitted together with the errors; its standard errors come from where the covariance does.
    frame : str
        What the array frame of the errors is.
    """
    noisy, noise_is_estimated = complete_noise(array, source)
    seen = as_if_uniform(source, errors, array, gradient)
    raw = measure_quality(source, noisy, errors, intensity_T)
    uniform = raw if seen is source else measure_quality(seen, noisy, errors, intensity_T)
    chi_square = uniform.reduced_chi_square
    if array.vector_noise_T is None and chi_square:
        factor = float(np.sqrt(chi_square.get("differential", chi_square.get("common_mode", 1.0))))
        noisy = replace(noisy, vector_noise_T=factor * noisy.vector_noise_T)
        if is_from_noise:
            covariance = factor**2 * covariance
            if gradient is not None:
                gradient = replace(gradient, standard_errors_T_per_m=factor * gradient.standard_errors_T_per_m)
        chi_square = measure_chi_square(seen, noisy, errors, intensity_T)
    return Calibration(
        method=method,
        array=noisy,
        noise_is_estimated=noise_is_estimated,
        errors=errors,
        covariance=covariance,
        has_scalar_reference=source.scalar_count is not None,
        intensity_T=intensity_T if uniform.mean_scalar_T is None else uniform.mean_scalar_T,
        before=raw.before,
        in_sample=uniform.after,
        floor=noise_floor(errors, noisy, noisy.scalar_noise_T),
        samples=source.sample_count,
        time_span_s=source.time_span_s,
        coverage=measure_coverage(field_of(source.thinned(SKETCH), errors)).fraction,
        reduced_chi_square=chi_square,
        ambient_gradient=gradient,
        frame=frame,
        temperature_C=mean_temperature(source),
    )


def mean_temperature(source: SampleSource) -> float | None:
    """Return the mean temperature of a recording, degrees Celsius; None where it was not recorded."""
    temperature_C = source.thinned(SKETCH).temperature_C
    return None if temperature_C is None else float(np.nanmean(temperature_C))
