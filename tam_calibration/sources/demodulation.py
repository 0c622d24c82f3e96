"""The field of an alternating source, separated from a slow background by least squares.

Where the frequency is not known it is found.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.model.array import tensors_of
from tam_calibration.model.exceptions import InputError, Refused
from tam_calibration.model.units import FloatArray

_PADDING = 4
_CHANCE = 1e-3
"""Probability that noise alone makes a peak that is taken for a source."""


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


def find_frequency(
    time_s: FloatArray, channels: FloatArray, background: FloatArray, lowest_hz: float, highest_hz: float
) -> Spectrum:
    """Return the spectrum of channels, and the frequency of the strongest line in it.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds; a periodogram of evenly spaced samples finds the line, and the times themselves its frequency.
    channels : (N, D) array
        Such as the readings of all axes.
    background : (N, Q) array
        Orthonormal columns that are taken off: see ``background_of``.
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

    time, values = np.asarray(time_s, dtype=float), np.asarray(channels, dtype=float)
    frequency, power = _periodogram(time, without(background, values), lowest_hz, highest_hz)
    threshold = float(gamma.isf(_CHANCE / len(frequency), values.shape[1]) / values.shape[1])
    best = int(power.argmax())
    if power[best] < threshold:
        raise Refused(
            f"no line exceeds the noise between {lowest_hz:g} and {highest_hz:g} Hz: the strongest, at "
            f"{frequency[best]:.4g} Hz, has {power[best]:.3g} times its power, and chance reaches {threshold:.3g}"
        )
    rest = without(background, values)
    rest = rest / _line(float(frequency[best]), time, rest, background)[1]
    resolution = 1 / np.ptp(time)
    found = minimize_scalar(
        lambda value: _residual_energy(value, time, rest, background),
        bounds=(frequency[best] - 0.7 * resolution, frequency[best] + 0.7 * resolution),
        method="bounded",
        options={"xatol": 1e-9 * frequency[best]},
    )
    return Spectrum(
        frequency, power, threshold, float(found.x), _standard_error(float(found.x), time, rest, background)
    )


def _periodogram(
    time: FloatArray, rest: FloatArray, lowest_hz: float, highest_hz: float
) -> tuple[FloatArray, FloatArray]:
    count = len(time)
    even = np.linspace(time[0], time[-1], count)
    values = np.stack([np.interp(even, time, channel) for channel in rest.T], axis=1)
    frequency = np.fft.rfftfreq(_PADDING * count, even[1] - even[0])
    searched = (frequency >= lowest_hz) & (frequency <= min(highest_hz, 0.5 / (even[1] - even[0])))
    if np.ptp(time) * lowest_hz < 1 or searched.sum() < _PADDING:
        raise InputError(
            f"between {lowest_hz:g} and {highest_hz:g} Hz a record of {np.ptp(time):g} s at "
            f"{(count - 1) / np.ptp(time):g} samples per second contains no frequency: change the bounds or the record"
        )
    power = np.abs(np.fft.rfft(values * np.hanning(count)[:, None], _PADDING * count, axis=0)[searched]) ** 2
    # The median of an exponential distribution is ln 2 times its mean.
    noise = np.median(power, axis=0) / np.log(2)
    alive = noise > 0
    if not alive.any():
        raise Refused("the channels hold nothing but the background: there is no source to be found")
    return frequency[searched], (power[:, alive] / noise[alive]).mean(axis=1)


def _carrier(frequency_hz: float, time: FloatArray, background: FloatArray) -> FloatArray:
    angle = 2 * np.pi * frequency_hz * (time - time[[0, -1]].mean())
    return without(background, np.stack([np.sin(angle), np.cos(angle)], axis=1))


def _residual_energy(frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray) -> float:
    """Return the squares that a sinusoid leaves of all channels, each over its noise, less those before."""
    orthonormal, _ = np.linalg.qr(_carrier(frequency_hz, time, background))
    return -float(np.sum((orthonormal.T @ rest) ** 2))


def _line(
    frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the amplitudes (2, D) of sine and cosine, and the noise (D,) that they leave."""
    carrier = _carrier(frequency_hz, time, background)
    amplitudes = np.linalg.lstsq(carrier, rest, rcond=None)[0]
    noise = np.sqrt(np.mean((rest - carrier @ amplitudes) ** 2, axis=0))
    return amplitudes, np.maximum(noise, 1e-12 * norm(rest, axis=0))


def _standard_error(frequency_hz: float, time: FloatArray, rest: FloatArray, background: FloatArray) -> float:
    """Return the Cramér–Rao bound of the frequency: the information of 2πf is T² N Σ (A/σ)²/24 over all channels."""
    amplitudes, noise = _line(frequency_hz, time, rest, background)
    information = np.ptp(time) ** 2 * len(time) * np.sum((amplitudes / noise) ** 2) / 24
    return float(1 / (2 * np.pi * np.sqrt(information)))


_DEGREE = 3
_SMALLEST_SHARE = 1e-9


def background_of(
    time_s: FloatArray, attitude: FloatArray | None = None, *, knot_spacing_s: float = np.inf
) -> FloatArray:
    """Return orthonormal columns (N, Q) that span the background of any channel of a platform.

    Parameters
    ----------
    time_s : (N,) array
        Times, seconds.
    attitude : (N, 4) array, optional
        Quaternions x, y, z, w from the array frame to the world. With them the columns hold the nine elements of the
        rotation: a channel that is linear in the field, calibrated or not, then follows any turning in a uniform field.
    knot_spacing_s : float
        Of the cubic splines of time, at least two periods of the source; by default there is one piece, a cubic.

    Returns
    -------
    (N, Q) array
        Orthonormal.

    Raises
    ------
    InputError
        When the spacing is not positive or there are fewer samples than columns.
    """
    from scipy.interpolate import BSpline

    time = np.asarray(time_s, dtype=float)
    if not knot_spacing_s > 0:
        raise InputError(f"the spacing of knots must be a positive number of seconds, not {knot_spacing_s}")
    pieces = max(1, int(np.ceil(np.ptp(time) / knot_spacing_s)))
    inner = np.linspace(time[0], time[-1], pieces + 1)
    knots = np.concatenate([np.full(_DEGREE, time[0]), inner, np.full(_DEGREE, time[-1])])
    columns = BSpline.design_matrix(time, knots, _DEGREE).toarray()
    if attitude is not None:
        columns = np.concatenate([columns, _rotations(attitude).reshape(len(time), 9)], axis=1)
    if columns.shape[1] >= len(time):
        raise InputError(f"{len(time)} samples are too few for a background of {columns.shape[1]} columns")
    left, size, _ = np.linalg.svd(columns, full_matrices=False)
    return left[:, size > _SMALLEST_SHARE * size[0]]


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


def turning_of(attitude: FloatArray, channel_count: int) -> FloatArray:
    """Return the (N, D, D) matrices from amplitudes that rest in the world to those in the array frame.

    Parameters
    ----------
    attitude : (N, 4) array
        Quaternions x, y, z, w from the array frame to the world.
    channel_count : int
        D: 3 for a field, 8 for field and gradient in the order of ``array.OUTPUT_NAMES`` without gzz.

    Raises
    ------
    InputError
        When there is another number of channels.
    """
    if channel_count not in (3, 8):
        raise InputError(f"a platform turns a field of 3 channels, or field and gradient of 8, not {channel_count}")
    matrix = _rotations(attitude)
    turning = np.zeros((len(matrix), channel_count, channel_count))
    turning[:, :3, :3] = np.swapaxes(matrix, 1, 2)
    if channel_count > 3:
        components = tensors_of(np.eye(8)[3:])
        turned = np.swapaxes(matrix, 1, 2)[:, None] @ components @ matrix[:, None]
        rows = [turned[..., 0, 0], turned[..., 0, 1], turned[..., 0, 2], turned[..., 1, 1], turned[..., 1, 2]]
        turning[:, 3:, 3:] = np.stack(rows, axis=1)
    return turning


def _rotations(attitude: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_quat(attitude).as_matrix())


_SMALLEST_PHASE_STEP = 1e-12
_STEPS = 20
_SMALLEST_REST = 0.01
"""Part of the signal's power that the background must leave."""


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
    phase_standard_error : float
        Radians.
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
    phase_standard_error: float
    noise: FloatArray
    out_of_phase: float

    @property
    def standard_errors(self) -> FloatArray:
        """(D,) standard errors of the amplitudes."""
        return np.sqrt(np.diag(self.covariance))


def demodulate(
    time_s: FloatArray,
    channels: FloatArray,
    frequency_hz: float,
    background: FloatArray,
    turning: FloatArray | None = None,
) -> Demodulated:
    """Return the amplitudes of an alternating field of known frequency.

    Parameters
    ----------
    time_s : (N,) array
        Times, in any spacing, seconds.
    channels : (N, D) array
        Such as the readings of all axes, or field and gradient, in any unit.
    frequency_hz : float
        Of the source.
    background : (N, Q) array
        Background of each channel, in any proportion: see ``background_of``.
    turning : (N, D, D) array, optional
        From amplitudes that rest in the world to those of the channels, for a platform that turns: see
        ``turning_of``. The amplitudes are then those in the world.

    Returns
    -------
    Demodulated
        Amplitudes at the common phase.

    Raises
    ------
    InputError
        When a shape is wrong, or the record is too short or too sparse for the frequency.
    Refused
        When the background explains all of the signal.
    """
    time, channels = _check(time_s, channels, frequency_hz)
    rest = without(background, channels)
    angle = 2 * np.pi * frequency_hz * (time - time[[0, -1]].mean())
    carrier = np.stack([np.sin(angle), np.cos(angle)], axis=1)
    solve = _solve_apart if turning is None else _solve_together
    amplitudes, covariance, noise = solve(rest, carrier, background, turning)
    return _in_phase(frequency_hz, amplitudes, covariance, noise)


def _check(time_s: FloatArray, channels: FloatArray, frequency_hz: float) -> tuple[FloatArray, FloatArray]:
    time, values = np.asarray(time_s, dtype=float), np.asarray(channels, dtype=float)
    if values.ndim != 2 or len(values) != len(time):
        raise InputError(f"channels must be {len(time)} rows, one for each time; their shape is {values.shape}")
    if not (np.isfinite(values).all() and np.isfinite(time).all()):
        raise InputError("a channel or time is not finite: leave out those samples")
    span = np.ptp(time)
    if not (np.isfinite(frequency_hz) and frequency_hz > 0) or span * frequency_hz < 1:
        raise InputError(f"{frequency_hz:g} Hz needs a record of one period at least, not of {span:g} s")
    rate = (len(time) - 1) / span
    if rate < 2 * frequency_hz:
        raise InputError(f"{frequency_hz:g} Hz cannot be told from another frequency at {rate:g} samples per second")
    return time, values


def _solve_apart(
    rest: FloatArray, carrier: FloatArray, background: FloatArray, _: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the amplitudes (2 D,) of sine and cosine, their covariance, and the noise (D,) of each channel."""
    design = without(background, carrier)
    inverse = _inverse(design.T @ design, carrier)
    found = inverse @ design.T @ rest
    freedom = len(rest) - background.shape[1] - 2
    noise = norm(rest - design @ found, axis=0) / np.sqrt(max(freedom, 1))
    return found.ravel(), np.kron(inverse, np.diag(noise**2)), noise


def _solve_together(
    rest: FloatArray, carrier: FloatArray, background: FloatArray, turning: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Do the same where all channels share amplitudes, each channel weighed by its noise."""
    assert turning is not None
    count, channels = rest.shape
    design = np.concatenate([turning * carrier[:, part, None, None] for part in (0, 1)], axis=2)
    design = without(background, design.reshape(count, -1)).reshape(design.shape)
    noise = norm(rest, axis=0) / np.sqrt(count)
    freedom = count - background.shape[1] - 2
    for _ in range(3):
        weighed = design / noise[:, None]
        # The unknowns have the units of the channels: the noise scales them, too.
        scale = np.tile(noise, 2)
        unit = (weighed * scale).reshape(-1, 2 * channels)
        inverse = _inverse(unit.T @ unit, carrier)
        found = scale * (inverse @ (unit.T @ (rest / noise).ravel()))
        noise = norm(rest - design @ found, axis=0) / np.sqrt(max(freedom, 1))
        if not (noise > 0).all():
            break
    return found, inverse * np.outer(scale, scale), noise


def _inverse(information: FloatArray, carrier: FloatArray) -> FloatArray:
    if np.linalg.eigvalsh(information)[0] < _SMALLEST_REST * len(carrier) / 2:
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
    for _ in range(_STEPS):
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
        if abs(step) < _SMALLEST_PHASE_STEP:
            break
    wrapped = (phase + np.pi / 2) % np.pi - np.pi / 2
    sign = np.cos(phase - wrapped).round()
    return Demodulated(
        frequency_hz,
        sign * amplitude * size,
        spread[:-1, :-1] * np.outer(size, size),
        float(wrapped),
        float(np.sqrt(spread[-1, -1])),
        noise,
        float(left @ weight @ left / max(len(noise) - 1, 1)),
    )
