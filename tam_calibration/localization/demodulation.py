"""The field of an alternating source out of what the sensors read beside it: synchronous least squares.

Each channel is a background, an amplitude times sin(2πf (t - t₀) + φ) and noise. The phase φ is that of the source and
common to all channels, so that each amplitude has a sign; the sign of all of them together stays open unless the
source's phase is known. t₀ is the middle of the record.
"""

from dataclasses import dataclass

import numpy as np
from numpy.linalg import inv, norm

from tam_calibration.exceptions import InputError, Refused
from tam_calibration.localization.background import without
from tam_calibration.units import FloatArray

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
        Of the amplitudes; the noise is taken from what is left of the channels.
    phase : float
        Of the source at the middle of the record, radians, between -π/2 and π/2.
    phase_standard_error : float
        Radians.
    noise : (D,) array
        Standard deviation of what is left of each channel.
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
        errors: FloatArray = np.sqrt(np.diag(self.covariance))
        return errors


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
        What each channel may hold beside it, in any proportion: see ``background_of``.
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
        When the background takes the whole signal.
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
    inverse: FloatArray = inv(information)
    return inverse


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
        spread = np.linalg.pinv(design.T @ weight @ design, hermitian=True)
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
