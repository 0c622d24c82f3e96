"""Where a gap lies: where its causes act or, without a cause, its strongest law."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from tam_calibration.effects.grades import MINOR, MOST
from tam_calibration.gap.hypothesis import Place
from tam_calibration.gap.laws.law import Place as LawPlace
from tam_calibration.gap.laws.law import Signature, acts_at, agrees
from tam_calibration.gap.laws.signature import Law
from tam_calibration.gap.result import Cause, Gap, Where
from tam_calibration.gap.whitened_channels import WhitenedChannels
from tam_calibration.model.fitted_effect import ALL, SCALAR
from tam_calibration.model.recording import Recording
from tam_calibration.model.units import FloatArray


def sensors_and_axes(places: Iterable[Place], recording: Recording) -> tuple[tuple[int | str, ...], tuple[str, ...]]:
    """Return the sensor numbers (or "scalar") and axes of places.

    A constant intensity in place of a scalar channel counts as all sensors.

    Parameters
    ----------
    places : iterable of Place
        Index of the sensor, ``SCALAR`` or ``ALL``, and of the axis; None for all axes.
    recording : Recording
        Of K sensors, with or without a scalar channel.
    """
    sensor_count = recording.sensor_count
    places = [(ALL if sensor == SCALAR and recording.scalar_T is None else sensor, axis) for sensor, axis in places]
    found = {sensor for sensor, _ in places}
    if ALL in found:
        found = found - {ALL} | set(range(sensor_count))
    sensors: list[int | str] = [sensor + 1 for sensor in sorted(found - {SCALAR})]
    if SCALAR in found:
        sensors.append("scalar")
    axes = {axis for sensor, axis in places if sensor != SCALAR}
    return tuple(sensors), tuple(name for index, name in enumerate("xyz") if axes & {index, None})


def span_of(channels: WhitenedChannels, excess: FloatArray) -> tuple[float, float] | None:
    """Return the span, s, that holds nearly all energy in excess of noise, where it is a small part of the run.

    Parameters
    ----------
    channels : WhitenedChannels
        Of N samples, with their time stamps.
    excess : (N,) array
        Energy of each sample in excess of that expected of noise alone; 0 where a sample does not count.
    """
    total = np.cumsum(excess)
    if total[-1] <= 0:
        return None
    margin = MINOR / 2
    first = int(np.searchsorted(total, margin * total[-1]))
    last = int(np.searchsorted(total, (1 - margin) * total[-1]))
    time_s = channels.covariates.time_s
    low, high = float(time_s[first]), float(time_s[min(last, len(time_s) - 1)])
    return (low, high) if high - low < MOST * float(np.ptp(time_s)) else None


def locate(channels: WhitenedChannels, causes: Sequence[Cause], laws: Sequence[Law], variance: float) -> Where:
    """Return where the gap of a nominal model lies.

    Parameters
    ----------
    channels : WhitenedChannels
        Of the nominal model.
    causes : sequence of Cause
        Without any the place of the strongest law is returned.
    laws : sequence of Law
        Of the gap.
    variance : float
        Of the channels' white noise.
    """
    sensors = tuple(sorted({sensor for cause in causes for sensor in cause.sensors}, key=str))
    axes = tuple(axis for axis in "xyz" if any(axis in cause.axes for cause in causes))
    if not sensors and laws:
        sensors, axes = laws[0].signature.sensors, laws[0].signature.axes
    excess = (channels.energy_per_sample / variance - channels.channels_per_sample) * channels.is_counted
    known = channels.is_counted & (channels.precision > 0)
    per_channel = {
        "differential_chi_square": _mean(channels.differential[channels.is_counted] ** 2),
        "common_mode_chi_square": _mean(channels.precision[known] * channels.intensity_residual_T[known] ** 2),
    }
    return Where(sensors, axes, span_of(channels, excess), _line(laws, channels), per_channel)


def _line(laws: Sequence[Law], channels: WhitenedChannels) -> tuple[float, float] | None:
    """Return the band, Hz, that a recording resolves about the tone of the strongest law; None where that is none."""
    if not laws or laws[0].signature.course != "tone":
        return None
    width_hz = 1 / float(np.ptp(channels.covariates.time_s))
    frequency_hz = float(str(laws[0].signature.follows).split()[0])
    return max(frequency_hz - width_hz, 0.0), frequency_hz + width_hz


def _mean(values: FloatArray) -> float:
    """Return the mean, NaN of nothing."""
    return float(np.mean(values)) if values.size else float("nan")


def placed(gap: Gap, laws: Sequence[Signature], places: Sequence[LawPlace]) -> Gap:
    """Return a gap that only the residual of the intensity shows at the likeliest of its places, and so its causes.

    Parameters
    ----------
    gap : Gap
        With its causes.
    laws : sequence of Signature
        The strongest first.
    places : sequence of Place
        Of the strongest law.
    """
    causes = tuple(_moved(one, laws, places[0]) for one in gap.causes)
    sensors = {sensor for one in causes for sensor in one.sensors} or set(places[0])
    axes = () if sensors == set(places[0]) else gap.where.axes
    where = replace(gap.where, sensors=tuple(sorted(sensors, key=str)), axes=axes)
    return replace(gap, causes=causes, where=where)


def _moved(cause: Cause, laws: Sequence[Signature], default: LawPlace) -> Cause:
    """Return a cause that acts on the scalar at the likeliest place of the strongest such law that it can make."""
    effect = cause.fitted.effect
    place = next((law.places[0] for law in laws if law.is_common and agrees(effect, law)), default)
    return replace(cause, sensors=place, axes=()) if "scalar" in cause.sensors and acts_at(effect, place) else cause
