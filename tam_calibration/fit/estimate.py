"""From an estimate to a calibration: noise, residuals, floor, whiteness and coverage, and how slow its residuals are.

Residuals of a real recording are those of noise and of what no calibration holds: the gradient of a room, a current, an
hysteresis. These last for many samples, which then tell less than as many independent ones. What moves the estimate is
the sum over the samples of their scores. Their sums weighted by slow cosines vary as it does (``core.noise``),
and are compared with the variance that white noise of the stated size gives them, all parameters together: each alone
would have too few degrees of freedom. The differential channels and the common mode are compared apart: on a vehicle
the scalar's residual may last while the sensors agree to their white noise.

Noise with outliers, by a multivariate Student-t distribution of some channels: how much each sample counts.

An M-estimate solves Σ w s = 0, with s the scores of the samples and w their weights. Its variance is the sandwich of
the mean square of the weighted channels and the square of their mean derivative.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from operator import mul

import numpy as np

from tam_calibration.core.least_squares import whitening
from tam_calibration.core.noise import BLOCKS, WHITE, SlowSums, VarianceFactors, complete_noise
from tam_calibration.correction.calibration import FRAME_STATEMENT, Calibration
from tam_calibration.fit.coverage import field_of, measure_coverage
from tam_calibration.fit.ellipsoid import Normalized
from tam_calibration.fit.information import rows_by_unknowns
from tam_calibration.fit.likelihood import ChannelMaps, Likelihood, energies
from tam_calibration.model.array import Array, KnownNoiseArray
from tam_calibration.model.recording import SKETCH, Block, Recording, SampleSource
from tam_calibration.model.sensor_errors import Residuals, ResidualSums, SensorErrors, noise_floor
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
        Raw readings.
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
        self._channels = ChannelMaps.at(errors.matrix, errors.bias_T, array.vector_noise_T)
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
    frame : str
        What the array frame of the errors is.
    """
    noisy, noise_is_estimated = complete_noise(array, source)
    measured = measure_quality(source, noisy, errors, intensity_T)
    chi_square = measured.reduced_chi_square
    if array.vector_noise_T is None and chi_square:
        factor = float(np.sqrt(chi_square.get("differential", chi_square.get("common_mode", 1.0))))
        noisy = replace(noisy, vector_noise_T=factor * noisy.vector_noise_T)
        if method == "maximum_likelihood":  # its covariance comes from the noise, not from the scatter of the data
            covariance = factor**2 * covariance
        chi_square = measure_chi_square(source, noisy, errors, intensity_T)
    return Calibration(
        method=method,
        array=noisy,
        noise_is_estimated=noise_is_estimated,
        errors=errors,
        covariance=covariance,
        has_scalar_reference=source.scalar_count is not None,
        intensity_T=intensity_T if measured.mean_scalar_T is None else measured.mean_scalar_T,
        before=measured.before,
        in_sample=measured.after,
        floor=noise_floor(errors, noisy, noisy.scalar_noise_T),
        samples=source.sample_count,
        time_span_s=source.time_span_s,
        coverage=measure_coverage(field_of(source.thinned(SKETCH), errors)).fraction,
        reduced_chi_square=chi_square,
        frame=frame,
        temperature_C=mean_temperature(source),
    )


def mean_temperature(source: SampleSource) -> float | None:
    """Return the mean temperature of a recording, degrees Celsius; None where it was not recorded."""
    temperature_C = source.thinned(SKETCH).temperature_C
    return None if temperature_C is None else float(np.nanmean(temperature_C))


_DEGREES_OF_FREEDOM = 6.0
"""With four sensors the standard errors are 1.04 times the bound's without outliers; with 4 they would be 1.05."""


@dataclass(frozen=True, eq=False)
class StudentNoise:
    """The noise of samples whose whitened channels are given.

    Parameters
    ----------
    energy : (N,) array
        Sum of the squares of each sample's whitened channels.
    channels : (N,) array
        Number of channels of each sample.
    square : float
        Square of the scale of the noise, in units of the stated one.
    """

    energy: FloatArray
    channels: FloatArray
    square: float

    @classmethod
    def of(cls, energy: FloatArray, channels: FloatArray) -> "StudentNoise":
        """Return the noise whose scale is the most likely one."""
        # One sensor tells nothing where the scalar is missing.
        known = channels > 0
        if not known.any():
            return cls(energy, channels, 1.0)
        # Of the scale of the noise: below a hundredth of what is stated lies only rounding.
        smallest_square = 1e-4
        noise = cls(energy, channels, max(float(np.median(energy[known] / channels[known])), smallest_square))
        while True:  # each step leaves a constant part of the way
            previous, square = noise.square, noise.spread_of(1)
            noise = cls(energy, channels, max(square, smallest_square))
            if square <= smallest_square or abs(square - previous) <= 1e-10 * square:
                break
        return noise

    @cached_property
    def weights(self) -> FloatArray:
        """(N,) weights of samples: about one for noise, small for outliers."""
        return (_DEGREES_OF_FREEDOM + self.channels) / (_DEGREES_OF_FREEDOM + self.energy / self.square)

    def spread_of(self, power: int) -> float:
        """Return the mean, over the channels, of the weights to a power times the squares; 1 where there is none."""
        return float(np.sum(self.weights**power * self.energy) / self.channels.sum()) if self.channels.any() else 1.0

    @property
    def variance_factor(self) -> float:
        """Variance of the weighted estimate over that of the inverse information with the stated noise."""
        if not self.channels.any():
            return 1.0
        slope = -self.weights / (_DEGREES_OF_FREEDOM * self.square + self.energy)
        derivative = np.sum(self.weights * self.channels + 2 * slope * self.energy) / self.channels.sum()
        return float(self.spread_of(2) / derivative**2)


OURS = ("maximum_likelihood", "robust")
"""Methods whose covariance is that of noise of the stated size."""

GROWING = (
    "the residual is correlated over the complete recording, which cannot show by how much such noise shifts its mean: "
    "standard errors, above all of biases, may still be too small"
)


def variance_factors(calibration: Calibration, recording: SampleSource) -> VarianceFactors:
    """Return the variance of what each channel tells a fit over that of white noise.

    Parameters
    ----------
    calibration : Calibration
        With the noise that the information counts with.
    recording : SampleSource
        That it was fitted to.

    Returns
    -------
    VarianceFactors
        Each 1 where white noise of the stated size makes as much at least once in a thousand recordings, where there
        are too few samples to tell, or where the channel tells nothing; else more than 1.
    """
    if recording.sample_count < BLOCKS:
        return WHITE
    return VarianceFactors(*(slow.factor for slow in _slow_sums(*_by_block(calibration, recording, ()))))


def widened(calibration: Calibration, recording: SampleSource) -> Calibration:
    """Return a calibration that says how long its residuals last, and whose standard errors hold it.

    Those of the published methods come from the scatter of groups of samples, which lasts as long: they stay.

    Parameters
    ----------
    calibration : Calibration
        That of maximum likelihood has a multiple of the inverse of the information for its covariance; of a robust
        fit the covariance holds the size of the noise.
    recording : SampleSource
        As for ``variance_factors``.
    """
    if recording.sample_count < BLOCKS:
        return calibration
    student: Sequence[StudentNoise] = ()
    if calibration.method == "robust":
        likelihood = _likelihood(calibration, recording, recording.scalar_count is not None)
        student = student_noises(likelihood, calibration.errors.matrix, np.zeros_like(calibration.errors.bias_T))
    by_block = _by_block(calibration, recording, student)
    slow = _slow_sums(*by_block)
    factors = stated = VarianceFactors(*(one.factor for one in slow))
    if any(one.is_growing for one in slow):
        calibration = replace(calibration, warnings=(*calibration.warnings, GROWING))
    if factors == WHITE or calibration.method not in OURS:
        return with_variance_factors(calibration, factors)
    covariance = calibration.covariance.copy()
    differential = by_block[0][0].sum(axis=0)
    if student:
        differential /= student[0].spread_of(2) * student[0].variance_factor
        excess = (noise.variance_factor for noise in student)
        stated = VarianceFactors(*map(mul, factors, excess)).at_least(WHITE)
    seen = np.delete(np.arange(len(covariance)), slice(9, 12))  # no uniform field sees a turn of all sensors
    inside, size = np.ix_(seen, seen), len(seen)
    covariance[inside] = _sandwich(covariance[inside], differential[:size, :size], factors)
    return replace(with_variance_factors(calibration, stated), covariance=covariance)


def _slow_sums(information: FloatArray, score: FloatArray) -> list[SlowSums]:
    """Return what each channel shows, from what ``_by_block`` returns."""
    # Part of the largest eigenvalue of a scaled information below which a direction is open.
    white = whitening(information.sum(axis=(0, 1)), 1e-9)
    return list(map(SlowSums.of, white.T @ information @ white, score @ white))


def with_variance_factors(calibration: Calibration, factors: VarianceFactors) -> Calibration:
    """Return a calibration that says by which factors what its channels tell varies more than by white noise."""
    by_channel = {"slow_differential": factors.differential, "slow_common_mode": factors.common_mode}
    slow = {name: factor for name, factor in by_channel.items() if factor != 1}
    return replace(calibration, reduced_chi_square=calibration.reduced_chi_square | slow)


def _sandwich(covariance: FloatArray, differential: FloatArray, factors: VarianceFactors) -> FloatArray:
    """Return the covariance of an estimate that took the noise of both channels for white.

    With the information A = I_d + I_c and the covariance C of the estimate by it, for which C A C = C whatever is held,
    that is C (f_d I_d + f_c I_c) C = f_c C + (f_d - f_c) C I_d C. A free intensity needs no row here: the differential
    channels do not see it.

    Parameters
    ----------
    covariance : (P, P) array
        C, of what white noise makes.
    differential : (P, P) array
        I_d, the information of the differential channels.
    factors : VarianceFactors
        f_d and f_c.
    """
    # Part of the largest eigenvalue of a scaled covariance below which lies rounding.
    root = covariance @ whitening(covariance, 1e-13)
    part, turn = np.linalg.eigh(root.T @ differential @ root)
    directions, part = root @ turn, np.clip(part, 0, 1)
    least = min(factors.differential, factors.common_mode)
    more = part * factors.differential + (1 - part) * factors.common_mode - least
    return np.asarray(least * covariance + directions * more @ directions.T)


def _by_block(
    calibration: Calibration, recording: SampleSource, student: Sequence[StudentNoise]
) -> tuple[FloatArray, FloatArray]:
    """Return what each channel tells of the errors, and of a free intensity, in blocks of time.

    Returns
    -------
    information : (2, M, Q, Q) array
        Of the differential channels, and of the common mode: the variance of the score where the noise is white.
    score : (2, M, Q) array
        Of these.
    """
    errors, intensity_T = calibration.errors, calibration.intensity_T
    has_scalar = recording.scalar_count is not None
    rows = np.delete(rows_by_unknowns(errors, intensity_T, None if has_scalar else intensity_T), slice(9, 12), axis=1)
    information = np.zeros((2, BLOCKS, rows.shape[1], rows.shape[1]))
    score = np.zeros((2, BLOCKS, rows.shape[1]))
    point, first = (errors.matrix, np.zeros_like(errors.bias_T)), 0
    variance = [noise.spread_of(2) for noise in student] or [1.0, 1.0]
    for block, part in _parts(recording):
        likelihood = _likelihood(calibration, part, has_scalar)
        here = scored = likelihood.linearize(*point)
        if student:
            weights = np.array([noise.weights[first : first + part.sample_count] for noise in student])
            scored = likelihood.linearize(*point, weights)
            first += part.sample_count
        for channel, own, of_score in ((0, here.between, scored.between), (1, here.common, scored.common)):
            information[channel, block] += rows.T @ own.information @ rows * variance[channel]
            score[channel, block] += rows.T @ of_score.score
    return information, score


def _likelihood(calibration: Calibration, recording: SampleSource, has_scalar: bool) -> Likelihood:
    """Return that of samples about the biases, in units of the intensity."""
    data = Normalized(recording, calibration.errors.bias_T, calibration.intensity_T, has_scalar)
    return Likelihood(data, *data.noise_of(calibration.array))


def student_noises(likelihood: Likelihood, matrix: FloatArray, bias: FloatArray) -> list[StudentNoise]:
    """Return the noise of the differential channels and of the common mode, at a point as of ``Likelihood.energy``.

    Each may be other than stated.
    """
    energy = likelihood.energy(matrix, bias)
    channels = np.isfinite(energy) * np.array([[3.0 * len(matrix) - 3], [1.0]])
    return list(map(StudentNoise.of, np.nan_to_num(energy), channels))


def _parts(recording: SampleSource) -> Iterator[tuple[int, Recording]]:
    """Yield the samples in the order of time, each part with the number of the block that it belongs to."""
    bounds, first = np.linspace(0, recording.sample_count, BLOCKS + 1).astype(int), 0
    for samples in recording.blocks():
        last = first + len(samples.time_s)
        inside = bounds[(bounds > first) & (bounds < last)]
        for start, stop in pairwise([first, *inside.tolist(), last]):
            part = slice(start - first, stop - first)
            scalar_T = None if samples.scalar_T is None else samples.scalar_T[part]
            block = int(np.searchsorted(bounds, start, side="right")) - 1
            yield block, Recording(samples.time_s[part], samples.readings_T[part], scalar_T)
        first = last
