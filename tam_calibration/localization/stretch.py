"""A stretch of a recording in which an alternating source is heard, and whether it has one frequency and one phase."""

from collections.abc import Sequence

import numpy as np

from tam_calibration.localization.solutions import CHANCE
from tam_calibration.model.exceptions import Refused
from tam_calibration.model.units import FloatArray
from tam_calibration.sources.demodulation import Demodulated, Stretch, demodulate, without

_SEARCHED = 0.7
"""Part of the resolution, one over the length of a stretch, within which the frequency is sought."""

_PRECISE = 1e-7
"""Part of the resolution to which it is found: less than any noise leaves."""

_LARGEST_ADVANCE = 0.1
"""Turns by which the phase may advance over a stretch where the frequency is stated: it was rounded then, and the one
that is found is taken."""

_CLEAR = 25.0
"""Mean square of the amplitudes over their standard errors below which noise moves the frequency as it likes."""

_SAME_PHASE = 1e-3
"""Part of the amplitudes that may be out of phase, all together: clocks of the sensors that differ by 16 µs make it at
10 Hz."""

_MEDIAN = 0.4549
"""Of χ² with one degree of freedom."""


def estimator_of(stretch: Stretch, found: Demodulated) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the sinusoid (N,) of a source whose channels turn, and what makes its amplitudes.

    The noise is the median of what is left at all frequencies: beside the source is also what bends over the array,
    which the amplitudes do not hold.

    Parameters
    ----------
    stretch : Stretch
        In which the source is heard.
    found : Demodulated
        Its amplitudes.

    Returns
    -------
    carrier : (N,) array
        Of the source, its amplitude one.
    estimator : (D, N, D) array
        From the channels to the amplitudes.
    covariance : (D, D) array
        Of the amplitudes.
    """
    from scipy.fft import dct

    assert stretch.turning is not None
    count, channels = stretch.channels.shape
    carrier = stretch.carrier(found.frequency_hz, found.phase)[:, 0]
    design = without(stretch.background, (carrier[:, None, None] * stretch.turning).reshape(count, -1))
    design = design.reshape(count, channels, channels)
    window = np.hanning(count)[:, None]
    power = dct(window * (stretch.rest - design @ found.amplitude), axis=0, norm="ortho") ** 2 / np.mean(window**2)
    noise = np.sqrt(np.median(power, axis=0) / _MEDIAN)
    unit = design / noise[:, None] * noise  # the unknowns have the units of the channels: the noise scales them too
    covariance = np.linalg.inv(np.einsum("npa,npb->ab", unit, unit))
    estimator = np.einsum("a,ab,npb,p->anp", noise, covariance, unit, 1 / noise, optimize=True)
    return carrier, estimator, covariance * np.outer(noise, noise)


def frequency_of(stretches: Sequence[Stretch], frequency_hz: float, is_stated: bool) -> float:
    """Return the frequency of a source near one that was stated or found.

    Parameters
    ----------
    stretches : sequence of Stretch
        In which it is heard.
    frequency_hz : float
        Near which it is, hertz.
    is_stated : bool
        Whether its phase may advance by no more than a tenth of a turn against it.

    Raises
    ------
    Refused
        When a stated frequency is off.
    """
    from scipy.optimize import minimize_scalar
    from scipy.special import chdtri

    size = [demodulate(stretch, frequency_hz).noise for stretch in stretches]
    if not all((noise > 0).all() for noise in size):
        return frequency_hz

    def energy(offset_hz: float) -> float:
        each = [demodulate(stretch, frequency_hz + offset_hz).noise for stretch in stretches]
        parts = zip(stretches, each, size, strict=True)
        return float(sum(len(own.time_s) * np.sum((now / before) ** 2) for own, now, before in parts))

    longest_s = max(stretch.span_s for stretch in stretches)
    widest_hz, options = _SEARCHED / longest_s, {"xatol": _PRECISE / longest_s}
    found = minimize_scalar(energy, bounds=(-widest_hz, widest_hz), method="bounded", options=options)
    hertz = frequency_hz + float(found.x)
    heard = [demodulate(stretch, hertz) for stretch in stretches]
    signal = np.mean([np.mean((each.amplitude / each.standard_errors) ** 2) for each in heard])
    # All channels have the noise that is left at the frequency that is found.
    count = sum(stretch.channels.size for stretch in stretches)
    if signal < _CLEAR or count * (energy(0.0) / float(found.fun) - 1) < chdtri(1, CHANCE):
        return frequency_hz
    turns = abs(float(found.x)) * longest_s
    if is_stated and turns > _LARGEST_ADVANCE:
        raise Refused(
            f"the frequency is off: against {frequency_hz:.9g} Hz the phase advances by {360 * turns:.3g}° in "
            f"{longest_s:.3g} s. State {hertz:.5g} Hz, or let it be found"
        )
    return hertz


def require_one_phase(found: Sequence[Demodulated]) -> None:
    """Refuse amplitudes of which more is out of phase than noise makes.

    Raises
    ------
    Refused
        When they are those of several sources.
    """
    from scipy.special import chdtrc

    freedom = sum(len(each.amplitude) - 1 for each in found)
    energy = sum(each.out_of_phase * (len(each.amplitude) - 1) for each in found)
    signal = sum(np.sum((each.amplitude / each.standard_errors) ** 2) for each in found)
    if chdtrc(freedom, energy) < CHANCE and energy > freedom + _SAME_PHASE**2 * signal:
        raise Refused(
            f"there are two sources, or the sensors' clocks differ: {100 * np.sqrt(energy / signal):.2g} % of the "
            "amplitudes are out of phase with the others. Switch off all sources but one"
        )
