"""The field of an alternating source, separated from a slow background by least squares.

Where the frequency is not known it is found. Of an array that was turned, the amplitudes are those in the poses in
which it stood still.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv, norm
from numpy.polynomial.legendre import legvander

from tam_calibration.model.array import TENSOR_COLUMNS, TENSOR_ROWS, UNIT_TENSORS
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.mounting import matrices_of
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray, from_degrees

_PADDING = 4
CHANCE = 1e-3
"""Probability with which noise alone makes a peak that is taken for a source, or fails a test of fit."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """Samples of a source that rests in the array frame, or in the world.

    Parameters
    ----------
    time_s : (N,) array
        Times, in any spacing, seconds.
    channels : (N, D) array
        Readings of all axes, or field and gradient, in any unit.
    background : (N, Q) array
        Background of each channel, in any proportion: orthonormal columns, see ``background_of``.
    turning : (N, D, D) array, optional
        From amplitudes that rest in the world to those of the channels, for a platform that turns: see ``turning_of``.
    """

    time_s: FloatArray
    channels: FloatArray
    background: FloatArray
    turning: FloatArray | None = None

    @classmethod
    def of(cls, recording: Recording, attitude: FloatArray | None = None) -> "Stretch":
        """Return the raw readings of a recording; with an attitude (N, 4) the array may turn in a uniform field."""
        channels = recording.readings_T.reshape(recording.sample_count, -1)
        return cls(recording.time_s, channels, background_of(recording.time_s, attitude))

    @property
    def span_s(self) -> float:
        """Seconds from the first to the last sample."""
        return float(np.ptp(self.time_s))

    @property
    def rate_hz(self) -> float:
        """Samples per second."""
        return (len(self.time_s) - 1) / self.span_s

    @property
    def rest(self) -> FloatArray:
        """(N, D) channels less their background."""
        return without(self.background, self.channels)

    def carrier(self, frequency_hz: float, phase: float = 0.0) -> FloatArray:
        """Return sine and cosine (N, 2), their phase counted from the middle of the stretch."""
        angle = 2 * np.pi * frequency_hz * (self.time_s - self.time_s[[0, -1]].mean()) + phase
        return np.stack([np.sin(angle), np.cos(angle)], axis=1)


def without(background: FloatArray, channels: FloatArray) -> FloatArray:
    """Return channels (N, D) less what orthonormal columns (N, Q) make of them.

    Parameters
    ----------
    background : (N, Q) array
        Orthonormal columns, as of ``background_of``.
    channels : (N, D) array
        Samples of D channels, in any unit.
    """
    return channels - background @ (background.T @ channels)


def background_of(time_s: FloatArray, attitude: FloatArray | None = None) -> FloatArray:
    """Return orthonormal columns (N, Q) that span the background of any channel of a platform: a cubic in time.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world. With them the columns hold the nine elements of the
        rotation: a channel that is linear in the field, calibrated or not, then follows any turning in a uniform field.

    Returns
    -------
    (N, Q) array
        Orthonormal.

    Raises
    ------
    InputError
        When there are fewer samples than columns.
    """
    columns = legvander(2 * (time_s - time_s[0]) / (np.ptp(time_s) or 1.0) - 1, 3)
    if attitude is not None:
        columns = np.concatenate([columns, matrices_of(attitude).reshape(len(time_s), 9)], axis=1)
    if columns.shape[1] >= len(time_s):
        raise InputError(f"{len(time_s)} samples are too few for a background of {columns.shape[1]} columns")
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(left[:, size > 1e-9 * size[0]])


def turning_of(attitude: FloatArray) -> FloatArray:
    """Return the (N, 8, 8) matrices from field and gradient that rest in the world to those in the array frame.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world. The eight channels are in the order of
        ``array.OUTPUT_NAMES``, without gzz.
    """
    matrix = matrices_of(attitude)
    back = np.swapaxes(matrix, 1, 2)
    turning = np.zeros((len(matrix), 8, 8))
    turning[:, :3, :3] = back
    turned = back[:, None] @ UNIT_TENSORS @ matrix[:, None]
    turning[:, 3:, 3:] = np.swapaxes(turned[..., TENSOR_ROWS, TENSOR_COLUMNS], 1, 2)
    return turning


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power of all channels over frequency, and the line that exceeds it.

    Parameters
    ----------
    frequency_hz : (F,) array
        From the lowest to the highest that was searched, hertz.
    power : (F,) array
        Mean over the channels of the power over that of each channel's noise: 1 where there is noise alone.
    threshold : float
        Power above which a peak is no chance.
    peak_hz : float
        Frequency of the source.
    peak_standard_error_hz : float
        Its standard error.
    """

    frequency_hz: FloatArray
    power: FloatArray
    threshold: float
    peak_hz: float
    peak_standard_error_hz: float


def find_frequency(stretch: Stretch, lowest_hz: float, highest_hz: float) -> Spectrum:
    """Return the spectrum of channels, and the frequency of the strongest line in it.

    A periodogram of evenly spaced samples finds the line, and the times themselves its frequency.

    Parameters
    ----------
    stretch : Stretch
        In which the source is heard.
    lowest_hz, highest_hz : float
        Where to search.

    Raises
    ------
    InputError
        When there is nothing to search between the two, or the record is too short or too sparse.
    Refused
        When no line exceeds the noise.
    """
    from scipy.optimize import minimize_scalar
    from scipy.stats import gamma

    rest, span_s = stretch.rest, stretch.span_s
    frequency, power = _periodogram(stretch, lowest_hz, highest_hz)
    threshold = float(gamma.isf(CHANCE / len(frequency), rest.shape[1]) / rest.shape[1])
    best = int(power.argmax())
    if power[best] < threshold:
        raise Refused(
            f"no line exceeds the noise between {lowest_hz:g} and {highest_hz:g} Hz: the strongest, at "
            f"{frequency[best]:.4g} Hz, has {power[best]:.3g} times its power, and chance reaches {threshold:.3g}"
        )

    def line(hertz: float) -> tuple[FloatArray, FloatArray]:
        """Return the amplitudes (2, D) of sine and cosine, and the noise (D,) that they leave."""
        carrier = without(stretch.background, stretch.carrier(hertz))
        amplitudes = np.linalg.lstsq(carrier, rest, rcond=None)[0]
        noise = np.sqrt(np.mean((rest - carrier @ amplitudes) ** 2, axis=0))
        return amplitudes, np.maximum(noise, 1e-12 * norm(rest, axis=0))

    def energy(hertz: float) -> float:
        orthonormal, _ = np.linalg.qr(without(stretch.background, stretch.carrier(hertz)))
        return -float(np.sum((orthonormal.T @ rest) ** 2))

    near_hz = float(frequency[best])
    rest = rest / line(near_hz)[1]
    bounds = (near_hz - 0.7 / span_s, near_hz + 0.7 / span_s)
    peak_hz = float(minimize_scalar(energy, bounds=bounds, method="bounded", options={"xatol": 1e-9 * near_hz}).x)
    amplitudes, noise = line(peak_hz)
    # Cramér and Rao: the information of 2πf is T² N Σ (A/σ)²/24 over all channels.
    information = span_s**2 * len(rest) * np.sum((amplitudes / noise) ** 2) / 24
    return Spectrum(frequency, power, threshold, peak_hz, float(1 / (2 * np.pi * np.sqrt(information))))


def _periodogram(stretch: Stretch, lowest_hz: float, highest_hz: float) -> tuple[FloatArray, FloatArray]:
    time, count = stretch.time_s, len(stretch.time_s)
    even = np.linspace(time[0], time[-1], count)
    values = np.stack([np.interp(even, time, channel) for channel in stretch.rest.T], axis=1)
    frequency = np.fft.rfftfreq(_PADDING * count, even[1] - even[0])
    searched = (frequency >= lowest_hz) & (frequency <= min(highest_hz, 0.5 / (even[1] - even[0])))
    if stretch.span_s * lowest_hz < 1 or searched.sum() < _PADDING:
        raise InputError(
            f"between {lowest_hz:g} and {highest_hz:g} Hz a record of {stretch.span_s:g} s at "
            f"{stretch.rate_hz:g} samples per second contains no frequency: change the bounds or the record"
        )
    power = np.abs(np.fft.rfft(values * np.hanning(count)[:, None], _PADDING * count, axis=0)[searched]) ** 2
    # The median of an exponential distribution is ln 2 times its mean.
    noise = np.median(power, axis=0) / np.log(2)
    alive = noise > 0
    if not alive.any():
        raise Refused("the channels hold nothing but the background: there is no source to be found")
    return frequency[searched], (power[:, alive] / noise[alive]).mean(axis=1)


@dataclass(frozen=True, eq=False)
class Demodulated:
    """The amplitudes of an alternating field.

    Parameters
    ----------
    frequency_hz : float
        At which the channels were demodulated.
    amplitude : (D,) array
        Peak amplitude with its sign, in the unit of each channel.
    covariance : (D, D) array
        Of the amplitudes; the noise is that of the residuals of the channels.
    phase : float
        Of the source at the middle of the record, radians, between -π/2 and π/2.
    noise : (D,) array
        Standard deviation of the residual of each channel.
    out_of_phase : float
        Sum of the squared amplitudes at right angles to the common phase, each over its standard error, per degree of
        freedom: near 1 where the source has one phase.
    """

    frequency_hz: float
    amplitude: FloatArray
    covariance: FloatArray
    phase: float
    noise: FloatArray
    out_of_phase: float

    @property
    def standard_errors(self) -> FloatArray:
        """(D,) standard errors of the amplitudes."""
        return np.sqrt(np.diag(self.covariance))


def demodulate(stretch: Stretch, frequency_hz: float) -> Demodulated:
    """Return the amplitudes of an alternating field of known frequency.

    Parameters
    ----------
    stretch : Stretch
        In which the source is heard.
    frequency_hz : float
        Of the source.

    Returns
    -------
    Demodulated
        Amplitudes at the common phase; of a platform that turns those in the world.

    Raises
    ------
    InputError
        When the record is too short or too sparse for the frequency.
    Refused
        When the background explains all of the signal.
    """
    if not (np.isfinite(frequency_hz) and frequency_hz > 0) or stretch.span_s * frequency_hz < 1:
        raise InputError(f"{frequency_hz:g} Hz needs a record of one period at least, not of {stretch.span_s:g} s")
    if stretch.rate_hz < 2 * frequency_hz:
        raise InputError(
            f"{frequency_hz:g} Hz cannot be told from another frequency at {stretch.rate_hz:g} samples per second"
        )
    solve = _solve_apart if stretch.turning is None else _solve_together
    return _in_phase(frequency_hz, *solve(stretch, stretch.carrier(frequency_hz)))


def _solve_apart(stretch: Stretch, carrier: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the amplitudes (2 D,) of sine and cosine, their covariance, and the noise (D,) of each channel."""
    design, rest = without(stretch.background, carrier), stretch.rest
    inverse = _inverse(design.T @ design, len(rest))
    found = inverse @ design.T @ rest
    noise = norm(rest - design @ found, axis=0) / np.sqrt(_freedom(stretch))
    return found.ravel(), np.kron(inverse, np.diag(noise**2)), noise


def _solve_together(stretch: Stretch, carrier: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Do the same where all channels share amplitudes, each channel weighed by its noise."""
    rest, turning = stretch.rest, stretch.turning
    assert turning is not None
    count, channels = rest.shape
    design = np.concatenate([turning * carrier[:, part, None, None] for part in (0, 1)], axis=2)
    design = without(stretch.background, design.reshape(count, -1)).reshape(design.shape)
    noise = norm(rest, axis=0) / np.sqrt(count)
    for _ in range(3):
        # The unknowns have the units of the channels: the noise scales them, too.
        scale = np.tile(noise, 2)
        unit = (design / noise[:, None] * scale).reshape(-1, 2 * channels)
        inverse = _inverse(unit.T @ unit, count)
        found = scale * (inverse @ (unit.T @ (rest / noise).ravel()))
        noise = norm(rest - design @ found, axis=0) / np.sqrt(_freedom(stretch))
        if not (noise > 0).all():
            break
    return found, inverse * np.outer(scale, scale), noise


def _freedom(stretch: Stretch) -> int:
    return max(len(stretch.time_s) - int(stretch.background.shape[1]) - 2, 1)


def _inverse(information: FloatArray, count: int) -> FloatArray:
    """Return the inverse of the information of N samples, of which the background leaves a hundredth at least."""
    if np.linalg.eigvalsh(information)[0] < 0.01 * count / 2:
        raise Refused("the background can make the signal itself: give it fewer columns, or take a longer record")
    return inv(information)


def _in_phase(frequency_hz: float, amplitudes: FloatArray, covariance: FloatArray, noise: FloatArray) -> Demodulated:
    """Turn the amplitudes of sine and cosine into those at the phase that fits all channels best."""
    sine, cosine = np.split(amplitudes, 2)
    size = np.sqrt(np.diag(covariance)[: len(noise)] + np.diag(covariance)[len(noise) :])
    size = np.where(size > 0, size, 1.0) if size.any() else np.ones_like(size)
    phase = 0.5 * np.arctan2(2 * np.sum(sine * cosine / size**2), np.sum((sine**2 - cosine**2) / size**2))
    scale = np.tile(size, 2)
    weight = inv(covariance / np.outer(scale, scale)) if np.diag(covariance).all() else np.eye(len(scale))
    values, unit = amplitudes / scale, np.eye(len(noise))
    for _ in range(20):
        both = np.concatenate([np.cos(phase) * unit, np.sin(phase) * unit])
        amplitude = inv(both.T @ weight @ both) @ both.T @ weight @ values
        by_phase = np.concatenate([-np.sin(phase) * amplitude, np.cos(phase) * amplitude])
        design = np.column_stack([both, by_phase])
        # The last column is the signal over the noise, which has no end in simulated data: scaled, no digits are lost.
        normal = design.T @ weight @ design
        length = np.sqrt(np.where(np.diag(normal) > 0, np.diag(normal), 1.0))
        spread = np.linalg.pinv(normal / np.outer(length, length), hermitian=True) / np.outer(length, length)
        left = values - both @ amplitude
        step = spread[-1] @ design.T @ weight @ left
        phase += step
        if abs(step) < 1e-12:
            break
    wrapped = (phase + np.pi / 2) % np.pi - np.pi / 2
    sign = np.cos(phase - wrapped).round()
    return Demodulated(
        frequency_hz,
        sign * amplitude * size,
        spread[:-1, :-1] * np.outer(size, size),
        float(wrapped),
        noise,
        float(left @ weight @ left / max(len(noise) - 1, 1)),
    )


_STILL = from_degrees(0.2)
"""An attitude that stays within this angle of its first is one pose, radians."""
FEWEST_PERIODS = 10.0
"""A pose lasts at least so many periods of the source."""


@dataclass(frozen=True, eq=False)
class PoseAmplitudes:
    """What the sensors read of a source in N poses.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world, in whose origin the array's centre is.
    amplitudes_T : (N, K, 3) array
        Raw, tesla; of each pose the sign of all together is open.
    noise_T : (N, K, 3) array
        Their standard errors.
    """

    attitude: FloatArray
    amplitudes_T: FloatArray
    noise_T: FloatArray


def amplitudes_of(recording: Recording, frequency_hz: float) -> PoseAmplitudes:
    """Return the amplitudes of a source in each pose of a recording.

    Parameters
    ----------
    recording : Recording
        Of an array that was turned and stood still in turn, with attitude.
    frequency_hz : float
        Of the source.

    Raises
    ------
    InputError
        When there is no attitude, or no pose lasts long enough.
    """
    if recording.attitude is None:
        raise InputError("the recording of the source has no attitude: without it the poses are not known")
    recording = recording.take(np.flatnonzero(np.isfinite(recording.attitude).all(axis=1)))
    assert recording.attitude is not None
    stretches = poses_of(recording, frequency_hz)
    if not stretches:
        raise InputError(
            f"the array stood still nowhere for {FEWEST_PERIODS / frequency_hz:g} s, {FEWEST_PERIODS:g} periods of the "
            f"source at {frequency_hz:g} Hz: let it rest in each heading"
        )
    middles = [(part.start + part.stop) // 2 for part in stretches]
    found = [demodulate(Stretch.of(recording.take(part)), frequency_hz) for part in stretches]
    amplitudes, noise = (
        np.array(values).reshape(len(found), -1, 3)
        for values in ([each.amplitude for each in found], [each.standard_errors for each in found])
    )
    return PoseAmplitudes(recording.attitude[middles], amplitudes, noise)


def poses_of(recording: Recording, frequency_hz: float) -> list[slice]:
    """Return the stretches of a recording, its attitude known throughout, in which the array stood still.

    Parameters
    ----------
    recording : Recording
        Its attitude known in every sample.
    frequency_hz : float
        Of the source: a stretch lasts at least ``FEWEST_PERIODS`` of its periods.
    """
    assert recording.attitude is not None
    shortest = FEWEST_PERIODS / frequency_hz
    return [part for part in _still(recording.attitude) if np.ptp(recording.time_s[part]) >= shortest]


def _still(attitude: FloatArray) -> list[slice]:
    """Return the stretches in which the attitude (N, 4) stays where it is at the first sample."""
    unit = attitude / np.linalg.norm(attitude, axis=1, keepdims=True)
    stretches, start = [], 0
    while start < len(unit):
        moved = np.abs(unit[start:] @ unit[start]) < np.cos(_STILL / 2)
        length = int(moved.argmax()) if moved.any() else len(moved)
        stretches.append(slice(start, start + length))
        start += length
    return stretches
